"""A robot's tool and the height of its base, from joint readings and measured coordinates of the same points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.calibration.observability import look
from dualarm_cli.calibration.tips import Flanges
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly

TOOL = ("tool x", "tool y", "tool z")
"""What the tool's coordinates are called."""
HEIGHT = "base height"
"""What the shift of the robot along its base frame's z is called."""


@dataclass(frozen=True)
class ToolFit:
    """What was found of one robot."""

    names: tuple[str, ...]
    """What was fitted: tool x, tool y, tool z, base height, or some of them."""
    values: FloatArray
    """Their values [m]; those that are not determined are as they were before, shape (k,)."""
    determined: BoolArray
    """Which of them the data determine, shape (k,)."""
    covariance: FloatArray | None
    """Their covariance [m^2], shape (k, k); None where nothing says how large the noise is."""
    degrees: int | None
    """Degrees of freedom of the residuals that the noise was estimated from; None where it was stated."""
    rms: float
    """Root mean square of the distances that are left [m]."""
    unseen: tuple[str, ...]
    """Directions that the data do not see, in words."""

    def value(self, name: str, default: float) -> float:
        """Returns a value [m], or the default for one that was not fitted."""
        return float(self.values[self.names.index(name)]) if name in self.names else default

    def tool(self, before: FloatArray) -> FloatArray:
        """Returns the tool's tip (3,) [m]; `before` where it was not fitted."""
        values = [self.value(name, float(v)) for name, v in zip(TOOL, before, strict=True)]
        return readonly(values)


def fit_tool(
    flanges: Flanges,
    xyz: FloatArray,
    tool: FloatArray,
    fitted: tuple[str, ...],
    noise: float | None,
) -> ToolFit:
    """Returns the tool and base height of least squares: xyz = p(q) + R(q) tool + height z, which is linear.

    Args:
        flanges: where the flange was at n points.
        xyz: measured coordinates of the tip [m], shape (n, 3).
        tool: the tool as the file has it [m], shape (3,); what the data do not determine stays as it is here.
        fitted: `tool`, `base_height` or both.
        noise: standard deviation of each coordinate [m]; None to estimate it from the residuals.
    """
    n = len(xyz)
    upward = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), (n, 3, 1))
    columns = [flanges.rotation] if "tool" in fitted else []
    columns += [upward] if "base_height" in fitted else []
    names = (TOOL if "tool" in fitted else ()) + ((HEIGHT,) if "base_height" in fitted else ())
    A = np.concatenate(columns, axis=2).reshape(3 * n, -1)
    sight = look(A, np.ones(len(names)))
    before = np.concatenate([tool if "tool" in fitted else [], np.zeros(len(names) % 3)])
    rest = (xyz - flanges.tips(tool)).ravel()
    step = sight.inverse @ rest
    rest = rest - A @ step
    degrees = 3 * n - sight.rank
    covariance = None
    if noise is not None:
        covariance = sight.covariance(noise**2)
    elif degrees > 0:
        covariance = sight.covariance(float(rest @ rest) / degrees)
    return ToolFit(
        names,
        readonly(before + step),
        sight.seen,
        covariance,
        None if noise is not None else degrees,
        float(np.sqrt(rest @ rest / n)),
        tuple(sight.in_words(names)),
    )
