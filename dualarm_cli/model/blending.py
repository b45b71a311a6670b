"""Blending laws: where tools need not stop, which `--blend` names."""

from __future__ import annotations

from collections.abc import Callable

from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.motion.rest_to_rest import PassingLaw, RestToRest
from dualarm_cli.notes import Note
from dualarm_cli.records import dataclass
from dualarm_cli.registry import Registry


@dataclass(frozen=True)
class Blending:
    """Blending law: where tools pass in motion, and the least times under it."""

    name: str
    """Word on the command line and in files."""
    summary: str
    """Places where tools do not stop, in a sentence."""
    reference: str
    """Paper and equation, or that it is our own."""
    straight: Callable[[Job], Job]
    """Job reduced to the straight parts of its lines.

    Its paths are as they are followed.
    """
    passes: Callable[[Stop], bool]
    """Test of stops whose target or outer line ends tools may pass in motion."""
    law: Callable[[RestToRest], RestToRest]
    """Timing law with blending, given the law from rest to rest."""
    assumption: Note | None = None
    """Assumption of the lower bound under that law; None for that of plans at rest."""


LINES = Blending(
    name="lines",
    summary="Tools pass the outer ends of approaches and retracts, and targets with `blend`, in motion.",
    reference="ours",
    straight=Job.blended,
    passes=lambda stop: bool(stop.approach or stop.retract or stop.blend),
    law=PassingLaw.of,
    assumption=Note(
        "lower bound: valid for every plan that keeps a given order and stops at its targets without blend. It "
        "assumes that straight lines start or end at rest, with the platform at rest, and that joints pass their "
        "other ends as fast as the limits permit",
        "lower bound",
        "lines",
    ),
)
STOPPING = Blending(
    name="none",
    summary="Tools stop at both ends of all lines.",
    reference="ours",
    straight=lambda job: job,
    passes=lambda _: False,
    law=lambda law: law,
)
BLENDINGS: Registry[Blending] = Registry("blending", "blend", [LINES, STOPPING])
