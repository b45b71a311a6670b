"""Figures without a screen: the same bytes for the same input."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from typing import Any

from dualarm_cli.errors import MissingDependencyError
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass

FIGURE_KINDS = ("png", "svg", "pdf")
"""Formats, as the ends of file names."""
Draw = Callable[[Schedule, Job, str], bytes]
"""Draws the figure of a plan as the content of a file of one of FIGURE_KINDS."""


@dataclass(frozen=True)
class KindFigures:
    """Figure that a kind of work adds to the Gantt chart, in `kinds/<kind>/figures.py` as FIGURES."""

    name: str
    """Ending of its file's name, such as paths."""
    shows: Callable[[Job], bool]
    """Test of jobs that have any of its work."""
    draw: Draw
    """Drawing function."""


def require_matplotlib() -> None:
    """Raise MissingDependencyError unless matplotlib is installed, without loading it."""
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise MissingDependencyError("matplotlib", "plot")


def new_figure(width: float, height: float) -> Any:
    """Create an empty matplotlib figure.

    Args:
        width: [inch].
        height: [inch].

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    try:
        # Not pyplot, whose backend is that of a notebook or none.
        import matplotlib as mpl
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingDependencyError("matplotlib", "plot") from None
    mpl.rcParams["svg.hashsalt"] = "dualarm"
    mpl.rcParams["font.size"] = 9
    return Figure(figsize=(width, height), layout="constrained")


def rendered(figure: Any, kind: str) -> bytes:
    """Render a figure as a file of one of FIGURE_KINDS, without dates."""
    metadata: dict[str, dict[str, None]] = {
        "png": {"Software": None},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }
    buffer = BytesIO()
    figure.savefig(buffer, format=kind, dpi=110, metadata=metadata[kind])
    return buffer.getvalue()
