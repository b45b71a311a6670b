"""Quality gate: compare every case with the baseline and its budget."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dualarm_cli.files.source.text_source import quote
from dualarm_cli.model.studies.evaluation import Evaluation, Finding
from dualarm_cli.records import dataclass
from dualarm_cli.scoring.baseline import Recorded
from dualarm_cli.scoring.verdict import STATES, State, Verdict

RATES = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True)
class GateSettings:
    """Thresholds of the gate."""

    limit_tolerance: float = 1e-9
    """Relative difference up to which limits count as equal."""
    min_growth: float = 1e-3
    """Growth of a part of the time from which it is reported [s]."""
    max_limits: int = 3
    """Maximum number of tightened limits in a message."""
    max_files: int = 4
    """Maximum number of changed files in a message."""
    min_improvement: float = 1e-3
    """Relative improvement from which a case counts as improved."""


GATE = GateSettings()

_PARTS = {
    "lines": "straight lines take",
    "dwells": "dwells take",
    "paths": "paths take",
    "seams": "seams take",
    "other": "waiting takes",
    "platform": "the platform takes",
    "left": "the left arm takes",
    "right": "the right arm takes",
}
"""Names of the parts of the time that belong to no joint."""


@dataclass(frozen=True)
class Tightened:
    """Joint limit that is tighter than in the baseline."""

    joint: str
    """Name of the joint."""
    text: str
    """Previous and present value, as text."""
    share: float
    """Ratio of the present to the previous limit; smaller is tighter."""


def why_slower(before: Recorded, now: Evaluation) -> str:
    """Explain the cause of a longer cycle time in one sentence.

    Among the joints with tightened limits, the joint with the largest growth of its part of the time is named first. If
    the part of none has grown, the plan avoids these joints: the sentence names them with their limits, and then the
    part that has grown.

    Args:
        before: recorded result of the case.
        now: present result, with a plan.
    """
    time = now.cycle_time or 0.0
    share = f" ({(time / before.cycle_time - 1.0) * 100:+.1f} %)" if before.cycle_time > 0.0 else ""
    grown = _grown(before.limiting, now.limiting)
    tightened = _tightened(before.limits, now)
    joints = {limit.joint for limit in tightened}
    blamed = next((name for name in grown if name in joints), "")
    parts = []
    if blamed:
        parts.append(_takes_more(blamed, before.limiting, now.limiting))
        joint_limits = [limit for limit in tightened if limit.joint == blamed]
        parts += [f"its {limit.text}" for limit in joint_limits[: GATE.max_limits]]
        if rest := [limit for limit in tightened if limit.joint != blamed]:
            parts.append(f"also {_listed(rest)}")
    elif tightened:
        parts.append(_listed(tightened))
        if grown:
            taken = _takes_more(grown[0], before.limiting, now.limiting)
            parts.append(f"so the plan differs: {taken}")
    elif grown:
        parts.append(_takes_more(grown[0], before.limiting, now.limiting))
    parts.append(_input_files(before.inputs, now.inputs))
    return f"cycle time {before.cycle_time:.3f} s -> {time:.3f} s{share}: {'; '.join(parts)}"


def _slower_here(before: Recorded, time: float, elsewhere: str) -> str:
    """Compose the message on a case that is slower than on another machine."""
    return (
        f"cycle time {before.cycle_time:.3f} s -> {time:.3f} s, and no file has changed: {elsewhere}. "
        "Score on a machine like that one, or record the baseline here with --update-baseline"
    )


def _grown(before: Mapping[str, float], now: Mapping[str, float]) -> list[str]:
    """List the parts of the time that have grown, largest growth first."""
    growth = {name: now.get(name, 0.0) - before.get(name, 0.0) for name in {*before, *now}}
    return sorted((n for n in growth if growth[n] > GATE.min_growth), key=lambda n: (-growth[n], n))


def _takes_more(name: str, before: Mapping[str, float], now: Mapping[str, float]) -> str:
    subject = _PARTS.get(name, f"{name} takes")
    return f"{subject} more of it ({before.get(name, 0.0):.3f} s -> {now.get(name, 0.0):.3f} s)"


def _tightened(before: Mapping[str, Mapping[str, float]], now: Evaluation) -> list[Tightened]:
    """List the joint limits that have become tighter, tightest first."""
    tightened = []
    for joint in sorted(now.limits):
        then, limits, slides = before.get(joint), now.limits[joint], joint in now.sliding
        if then is None:
            continue
        for name in RATES:
            old, new = then.get(name, math.inf), limits.get(name, math.inf)
            if new < old * (1.0 - GATE.limit_tolerance):
                unit = _unit(name, slides)
                text = f"{name} limit was {_shown(old, slides)} {unit}, now {_shown(new, slides)} {unit}"
                tightened.append(Tightened(joint, text, new / old if math.isfinite(old) else 0.0))
        for name, sign in (("lower", 1.0), ("upper", -1.0)):
            old, new = then.get(name, -sign * math.inf), limits.get(name, -sign * math.inf)
            if sign * (new - old) > GATE.limit_tolerance:
                unit = "mm" if slides else "deg"
                text = f"{name} limit was {_shown(old, slides)} {unit}, now {_shown(new, slides)} {unit}"
                tightened.append(Tightened(joint, text, 1.0))
    return sorted(tightened, key=lambda limit: (limit.share, limit.joint))


def _unit(name: str, slides: bool) -> str:
    power = {"velocity": "s", "acceleration": "s²", "jerk": "s³"}[name]
    return f"{'mm' if slides else 'deg'}/{power}"


def _shown(value: float, slides: bool) -> str:
    if not math.isfinite(value):
        return "none"
    return f"{1e3 * value if slides else math.degrees(value):.6g}"


def _listed(limits: list[Tightened]) -> str:
    """List the first tightened limits and the number of the others."""
    text = ", ".join(f"{limit.joint}'s {limit.text}" for limit in limits[: GATE.max_limits])
    more = len(limits) - GATE.max_limits
    return text + (f" and {more} more" if more > 0 else "")


def _input_files(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """List the changed input files."""
    changed = sorted(name for name in {*before, *now} if before.get(name) != now.get(name))
    if not changed:
        return "no file has changed, so the cause is dualarm or one of its libraries"
    more = len(changed) - GATE.max_files
    tail = f" and {more} more" if more > 0 else ""
    return f"changed since: {', '.join(changed[: GATE.max_files])}{tail}"


FLOOR = 1e-3
"""Absolute tolerance of cycle times [s]; the last digits differ between machines."""


def judge_all(
    evaluations: Mapping[str, Evaluation],
    baseline: Mapping[str, Recorded] | None,
    max_regression: float,
    *,
    subset: bool = False,
    elsewhere: str = "",
) -> list[Verdict]:
    """Judge every case that was planned or is in the baseline, sorted by name.

    Args:
        evaluations: present results by case.
        baseline: recorded results by case; None without a baseline.
        max_regression: allowed relative increase of a cycle time.
        subset: whether cases of the baseline that were not planned are left out, instead of missing.
        elsewhere: description of the baseline's machine if it differs from this one, else empty.
    """
    recorded = baseline or {}
    cases = set(evaluations) | (set() if subset else set(recorded))
    fresh = {
        _files(e.inputs): case
        for case, e in evaluations.items()
        if case not in recorded and e.inputs
    }
    return [
        judge(
            case,
            evaluations[case],
            recorded.get(case),
            max_regression,
            compared=baseline is not None,
            elsewhere=elsewhere,
        )
        if case in evaluations
        else _missing(case, recorded[case], fresh.get(_files(recorded[case].inputs), ""))
        for case in sorted(cases)
    ]


def _missing(case: str, before: Recorded, renamed: str) -> Verdict:
    """Judge a case that was not planned.

    `renamed` is a new case with exactly the files of this one, or empty.
    """
    text = (
        "is in the baseline, but was not scored; --update-baseline removes it, "
        "--subset ignores cases that are not named"
    )
    if renamed:
        text = f"is now named {quote(renamed)}, with the same files; --update-baseline stores the new name"
    return Verdict(case, "missing", None, before, (Finding(text, case),))


def _files(inputs: Mapping[str, str]) -> frozenset[tuple[str, str]]:
    """Return the input files of a case as (name, SHA-256) pairs."""
    return frozenset(inputs.items())


def judge(
    case: str,
    evaluation: Evaluation,
    before: Recorded | None,
    max_regression: float,
    *,
    compared: bool,
    elsewhere: str = "",
) -> Verdict:
    """Judge one case.

    Args:
        case: its name.
        evaluation: present result.
        before: recorded result; None for a case that the baseline lacks.
        max_regression: allowed relative increase of the cycle time.
        compared: whether there is a baseline.
        elsewhere: description of the baseline's machine if it differs from this one, else empty.
    """
    if evaluation.status != "planned":
        return Verdict(case, evaluation.status, evaluation, before, evaluation.findings)
    time = evaluation.cycle_time
    if time is None or not math.isfinite(time) or time < 0.0:
        reason = Finding("the cycle time is not a number, or negative", case)
        return Verdict(case, "internal_error", evaluation, before, (reason,))
    states: list[State] = []
    reasons: list[Finding] = []
    for line in evaluation.budgets:
        if not line.kept:
            states.append("over_budget")
            reasons.append(Finding(f"{line.figures} (budget)", line.file, line.line, line.column))
    if before is not None:
        slower = time - before.cycle_time
        if slower > max(FLOOR, max_regression * before.cycle_time):
            same_files = elsewhere and _files(before.inputs) == _files(evaluation.inputs)
            states.append("other_machine" if same_files else "regressed")
            text = (
                _slower_here(before, time, elsewhere)
                if same_files
                else why_slower(before, evaluation)
            )
            reasons.insert(0, Finding(text, case))
        elif -slower > max(FLOOR, GATE.min_improvement * before.cycle_time):
            states.append("improved")
    elif compared:
        states.append("new")
    state: State = min(states, key=STATES.index, default="pass")
    return Verdict(case, state, evaluation, before, tuple(reasons))
