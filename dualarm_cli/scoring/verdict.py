"""Verdict: what became of one case, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from dualarm_cli.model.evaluation import Evaluation, Finding
from dualarm_cli.records import dataclass
from dualarm_cli.scoring.baseline import Recorded

State = Literal[
    "internal_error",
    "crashed",
    "bad_input",
    "infeasible",
    "timed_out",
    "fails_verification",
    "missing",
    "regressed",
    "over_budget",
    "other_machine",
    "improved",
    "new",
    "pass",
]
STATES: tuple[str, ...] = get_args(State)
"""Most severe first."""
EXIT_CODES: Mapping[str, int] = {
    "internal_error": 4,
    "crashed": 4,
    "bad_input": 2,
    "infeasible": 3,
    "timed_out": 1,
    "fails_verification": 1,
    "missing": 1,
    "regressed": 1,
    "over_budget": 1,
    "other_machine": 0,
    "improved": 0,
    "new": 0,
    "pass": 0,
}
"""What each state alone makes the process end with."""
SEVERITY = (4, 2, 3, 1, 0)
"""Exit codes, most severe first."""


@dataclass(frozen=True)
class Verdict:
    """What became of one case."""

    case: str
    """Its name."""
    state: State
    """The most severe of what can be said of it."""
    evaluation: Evaluation | None
    """What it came to; None for one that is missing."""
    before: Recorded | None
    """What it came to when the baseline was made; None where it is not in there, or there is none."""
    reasons: tuple[Finding, ...]
    """Why it is not simply a pass."""

    @property
    def failed(self) -> bool:
        """Whether the gate is closed for it."""
        return EXIT_CODES[self.state] != 0

    @property
    def caveats(self) -> tuple[str, ...]:
        """Sentences on what the verifier's pass leaves open; nothing for a case that fails."""
        return () if self.failed or self.evaluation is None else self.evaluation.caveats

    @property
    def change(self) -> float | None:
        """By what share the cycle time is longer than it was; None where one of both is not known, or was 0."""
        if self.before is None or self.evaluation is None or self.evaluation.cycle_time is None:
            return None
        then = self.before.cycle_time
        return (self.evaluation.cycle_time - then) / then if then > 0.0 else None


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Returns what the process ends with: the most severe of its cases."""
    codes = {EXIT_CODES[verdict.state] for verdict in verdicts}
    return next(code for code in SEVERITY if code in codes)


def words(state: str) -> str:
    """Returns a state as people say it."""
    return state.replace("_", " ")
