"""What a controller logged, or another program returned: joint positions at instants."""

from __future__ import annotations

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LoggedMotion:
    """Samples of some of a robot's joints; time 0 is the start of the plan."""

    joints: tuple[str, ...]
    """Names of the n joints, in column order."""
    time: FloatArray
    """Instants, rising [s], shape (k,) with k > 1."""
    position: FloatArray
    """[rad], shape (k, n); m for joints that slide, here and below."""
    velocity: FloatArray | None = None
    """[rad/s], shape (k, n); None where not every joint has it."""
    acceleration: FloatArray | None = None
    """[rad/s²], shape (k, n); None where not every joint has it."""
