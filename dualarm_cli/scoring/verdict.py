"""Verdict on one case: its state and the reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from dualarm_cli.model.studies.evaluation import Evaluation, Finding
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
"""States, most severe first."""
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
"""Exit code of each state alone."""
SEVERITY = (4, 2, 3, 1, 0)
"""Exit codes, most severe first."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one case."""

    case: str
    """Name of the case."""
    state: State
    """Most severe state that applies."""
    evaluation: Evaluation | None
    """Present result; None for a missing case."""
    before: Recorded | None
    """Recorded result; None without a baseline, or if the baseline lacks the case."""
    reasons: tuple[Finding, ...]
    """Reasons why the case is not a plain pass."""

    @property
    def failed(self) -> bool:
        """Flag of a case that fails the gate."""
        return EXIT_CODES[self.state] != 0

    @property
    def caveats(self) -> tuple[str, ...]:
        """Caveats of the verifier's pass; empty for a failed case."""
        return () if self.failed or self.evaluation is None else self.evaluation.caveats

    @property
    def change(self) -> float | None:
        """Relative increase of the cycle time, or None.

        None if either time is unknown or the recorded one is 0.
        """
        if self.before is None or self.evaluation is None or self.evaluation.cycle_time is None:
            return None
        then = self.before.cycle_time
        return (self.evaluation.cycle_time - then) / then if then > 0.0 else None


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Select the process's exit code: that of the most severe case."""
    codes = {EXIT_CODES[verdict.state] for verdict in verdicts}
    return next(code for code in SEVERITY if code in codes)


def words(state: str) -> str:
    """Format a state as words."""
    return state.replace("_", " ")
