"""Document of `dualarm why`: critical path, slack, levers and combinations, JSON-ready."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dualarm_cli import __version__
from dualarm_cli.levers.estimates import ONLY_PLANNED, Estimate
from dualarm_cli.levers.replanning import Replanned
from dualarm_cli.levers.stops import PartialLever
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.report import comparisons as members
from dualarm_cli.report.critical_path import CriticalPath, critical_path


def why_document(
    schedule: Schedule,
    job: Job,
    case: str,
    estimates: Sequence[Estimate],
    replanned: Sequence[Replanned],
    stops: Mapping[str, Sequence[PartialLever]],
) -> members.WhyReport:
    """Compose the document.

    Args:
        schedule: the plan.
        job: its job.
        case: name of its task file.
        estimates: of all levers, largest first.
        replanned: levers and combinations that were re-planned.
        stops: parts of levers, by their names and changes.
    """
    path = critical_path(schedule)
    alone = {result.names[0]: result for result in replanned if len(result.levers) == 1}
    ranked = sorted(estimates, key=lambda e: -_rank(e, alone.get(str(e.lever))))
    place = {str(estimate.lever): k for k, estimate in enumerate(ranked)}
    together = sorted(
        (result for result in replanned if len(result.levers) > 1),
        key=lambda result: -(result.gain or 0.0),
    )
    required = None if job.budget is None else job.budget.cycle_time
    return {
        "format": "dualarm.why/1",
        "version": __version__,
        "job": case,
        "effort": str(schedule.provenance.settings.get("effort", "")),
        "cycle_time": schedule.duration,
        "required": required,
        "shares": [
            {"group": group, "kind": kind, "time": time}
            for (group, kind), time in path.seconds().items()
        ],
        "critical_path": _links(path),
        "pieces": [_piece(path, k) for k in range(len(path.pieces))],
        "levers": [
            _lever(estimate, alone.get(str(estimate.lever)), stops.get(str(estimate.lever), ()))
            for estimate in ranked
        ],
        "combinations": [
            {
                "levers": [place[name] for name in result.names],
                "status": result.evaluation.status,
                "cycle_time": result.cycle_time,
                "gain": result.gain,
            }
            for result in together
        ],
        "sentences": sentences(schedule, required, replanned, ranked),
    }


def _rank(estimate: Estimate, result: Replanned | None) -> float:
    """Rank a lever: by its verified gain, else by its estimate, the others last."""
    if result is not None:
        return -1e6 if result.gain is None else result.gain
    return -1e9 if estimate.gain is None else estimate.gain


def _links(path: CriticalPath) -> list[members.WhyLink]:
    index = {id(piece): k for k, piece in enumerate(path.pieces)}
    return [
        {"piece": None if piece is None else index[id(piece)], "start": start, "end": end}
        for piece, start, end in path.chain
    ]


def _piece(path: CriticalPath, k: int) -> members.WhyPiece:
    piece = path.pieces[k]
    return {
        "group": piece.group,
        "kind": piece.kind,
        "task": piece.task,
        "action": piece.action,
        "stage": piece.stage + 1,
        "start": piece.start,
        "end": piece.end,
        "length": piece.length,
        "slack": piece.slack,
    }


def _lever(
    estimate: Estimate, result: Replanned | None, stops: Sequence[PartialLever]
) -> members.WhyLever:
    lever = estimate.lever
    return {
        "name": lever.name,
        "change": lever.change,
        "kind": lever.kind,
        "values": dict(lever.values),
        "estimate": estimate.gain,
        "reason": estimate.reason,
        "status": "" if result is None else result.evaluation.status,
        "cycle_time": None if result is None else result.cycle_time,
        "gain": None if result is None else result.gain,
        "stops": [
            {"share": stop.share, "change": stop.lever.change, "estimate": stop.gain}
            for stop in stops
        ],
    }


def best_set(replanned: Sequence[Replanned], required: float | None) -> Replanned | None:
    """Select what to apply: the fewest levers that meet a missed budget, else the largest gain.

    Another robot is no change of the cell, and is left out.
    """
    usable = [
        result
        for result in replanned
        if result.gain is not None
        and result.gain > 0.0
        and all(lever.kind != "robot" for lever in result.levers)
    ]
    meets = [
        result
        for result in usable
        if required is not None and (result.cycle_time or 0.0) <= required < result.before
    ]
    if meets:
        return min(meets, key=lambda result: (len(result.levers), result.gain or 0.0))
    return max(usable, key=lambda result: result.gain or 0.0, default=None)


def sentences(
    schedule: Schedule,
    required: float | None,
    replanned: Sequence[Replanned],
    estimates: Sequence[Estimate],
) -> list[str]:
    """Say what meets the budget, or what helps most; the largest estimate if nothing was re-planned.

    Levers that only another plan shows are named unless they were re-planned; the sentence with the result is last.
    """
    best = best_set(replanned, required)
    words = _unknown(replanned, estimates)
    if required is not None and schedule.duration <= required:
        words.append(f"the budget of {required:g} s is met: {schedule.duration:.3f} s")
    gains = [(e.gain, e.lever) for e in estimates if e.gain is not None and e.gain > 0.0]
    if not gains and any(e.gain is not None for e in estimates):
        words.append("no lever is estimated to gain time")
    if not replanned and gains:
        gain, lever = max(gains, key=lambda estimate: estimate[0])
        share = -gain / schedule.duration
        words.append(
            f"largest estimate: {lever}, {gain:.3f} s ({share:.1%}); nothing was re-planned"
        )
    if best is not None:
        time = best.cycle_time or 0.0
        *first, last = best.names
        levers = f"{', '.join(first)} and {last}" if first else last
        both = " together" if len(best.levers) > 1 else ""
        gives = f"{levers}{both} give{'' if both else 's'} {time:.3f} s, verified"
        if required is None or schedule.duration <= required:
            share = (best.gain or 0.0) / schedule.duration
            words.append(f"most of what was re-planned: {gives} ({-share:.1%})")
        elif time <= required:
            words.append(f"needs {required:g} s: {gives}")
        else:
            words.append(f"needs {required:g} s, which nothing that was re-planned gives: {gives}")
    return words


def _unknown(replanned: Sequence[Replanned], estimates: Sequence[Estimate]) -> list[str]:
    """Say why nothing has an estimate, and which levers only another plan shows."""
    words = []
    modelled = [e for e in estimates if e.lever.is_modelled]
    if modelled and all(e.gain is None for e in modelled):
        words.append(f"no lever has an estimate: {modelled[0].reason}")
    planned = {name for result in replanned for name in result.names}
    unknown = [e.lever for e in estimates if e.reason == ONLY_PLANNED]
    others = [lever.name for lever in unknown if str(lever) not in planned]
    if others:
        words.append(
            f"only new plans show what these gain, with --budget '5 min': {', '.join(others)}"
        )
    return words
