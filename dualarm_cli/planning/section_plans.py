"""Plans of jobs with paths and seams in several section orders; the fastest wins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice, pairwise, permutations

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job, PoseTarget, Task
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.orders.model.buffer_numbers import keeps_borders
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.notes import order_note
from dualarm_cli.planning.planned_job import PlannedJob
from dualarm_cli.planning.sections import sections_plan
from dualarm_cli.records import dataclass

MOST_PERMUTATIONS = 5040
"""Maximum number of orders of paths and seams to compare."""


@dataclass(frozen=True)
class _Rules:
    """Order rules of a job's tasks, by index."""

    alone: tuple[tuple[int, ...], ...]
    """Tasks of each path or seam, one for each arm."""
    units: tuple[tuple[int, ...], ...]
    """All other tasks; those of a sequence together, and both shares of a hand-over."""
    before: tuple[tuple[int, int], ...]
    """Pairs (before, after) of tasks."""


def section_orders(model: CellModel, job: Job, most: int) -> list[Job]:
    """List orders of a job's tasks, the file's first, then the best estimates.

    Paths and seams in every order that keeps precedence; all other tasks in as few runs between them as precedence
    allows (each run is ordered by itself when it is planned), because every break makes both arms wait for each other.
    Orders in which a buffer cannot hold what is left in it by a break are left out, but for the file's.
    Ranked by the number of runs and by how far the tools travel between sections.

    Args:
        model: the job's cell.
        job: job with paths or seams.
        most: maximum number of orders.
    """
    rules = _rules(job)
    orders: dict[tuple[int, ...], tuple[int, float]] = {}
    for sigma in islice(permutations(range(len(rules.alone))), MOST_PERMUTATIONS):
        for order in _placed(rules, sigma):
            if order not in orders:
                changed = replace(job, tasks=tuple(job.tasks[t] for t in order))
                sections = changed.sections()
                if not keeps_borders(changed):
                    continue
                orders[order] = (len(sections), _travel(model, job, sections))
    given = tuple(range(len(job.tasks)))
    ranked = sorted((rank, order) for order, rank in orders.items() if order != given)
    rows = [given, *(order for _, order in ranked)][:most]
    return [replace(job, tasks=tuple(job.tasks[t] for t in order)) for order in rows]


def _rules(job: Job) -> _Rules:
    numbers: dict[str, list[int]] = {}
    for t, task in enumerate(job.tasks):
        numbers.setdefault(task.id, []).append(t)
    alone = [tuple(numbers[name]) for name in numbers if job.tasks[numbers[name][0]].alone]
    rows = [tuple(t for name in row for t in numbers[name]) for row in job.sequences]
    # Both tasks of a hand-over meet, so they belong to one run.
    rows += [
        tuple(numbers[name]) for name in numbers if job.tasks[numbers[name][0]].handover is not None
    ]
    within = {t for row in (*alone, *rows) for t in row}
    singles = [(t,) for t in range(len(job.tasks)) if t not in within]
    before = [
        (a, t) for t, task in enumerate(job.tasks) for name in task.after for a in numbers[name]
    ]
    return _Rules(tuple(alone), tuple(sorted((*rows, *singles))), tuple(before))


def _placed(rules: _Rules, sigma: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Yield orders of all tasks around given paths and seams; none if infeasible."""
    place = {t: k for k, a in enumerate(sigma) for t in rules.alone[a]}
    if any(place[a] >= place[b] for a, b in rules.before if a in place and b in place):
        return
    gaps = _gaps(rules, place, len(sigma))
    if gaps is None:
        return
    single = set(range(len(sigma) + 1)).intersection(*(range(e, m + 1) for e, m in gaps))
    choices = [[g] * len(gaps) for g in sorted(single)] if gaps else [[]]
    if not single:
        choices = [_stabbed(gaps), [len(sigma) - g for g in _stabbed(_mirrored(gaps, len(sigma)))]]
    for chosen in choices:
        order: list[int] = []
        for k in range(len(sigma) + 1):
            order += sorted(
                t for unit, g in zip(rules.units, chosen, strict=True) if g == k for t in unit
            )
            if k < len(sigma):
                order += rules.alone[sigma[k]]
        yield tuple(order)


def _gaps(rules: _Rules, place: dict[int, int], last: int) -> list[tuple[int, int]] | None:
    """Compute each unit's first and last gap between paths and seams; None if infeasible.

    Gap k is before path or seam k.
    """
    first, last_gap = [0] * len(rules.units), [last] * len(rules.units)
    unit_of = {t: u for u, unit in enumerate(rules.units) for t in unit}
    for _ in range(len(rules.units) + 1):
        for a, b in rules.before:
            if a in unit_of and b in unit_of:
                unit_a, unit_b = unit_of[a], unit_of[b]
                first[unit_b] = max(first[unit_b], first[unit_a])
                last_gap[unit_a] = min(last_gap[unit_a], last_gap[unit_b])
            elif b in unit_of:
                first[unit_of[b]] = max(first[unit_of[b]], place[a] + 1)
            elif a in unit_of:
                last_gap[unit_of[a]] = min(last_gap[unit_of[a]], place[b])
    if any(e > m for e, m in zip(first, last_gap, strict=True)):
        return None
    return list(zip(first, last_gap, strict=True))


def _stabbed(gaps: Sequence[tuple[int, int]]) -> list[int]:
    """Assign units to as few gaps as possible, each as late as possible."""
    used: list[int] = []
    for e, m in sorted(gaps, key=lambda gap: gap[1]):
        if not used or used[-1] < e:
            used.append(m)
    return [next(g for g in used if e <= g <= m) for e, m in gaps]


def _mirrored(gaps: Sequence[tuple[int, int]], last: int) -> list[tuple[int, int]]:
    """Count the gaps from the end."""
    return [(last - m, last - e) for e, m in gaps]


def _travel(model: CellModel, job: Job, sections: Sequence[tuple[Task, ...]]) -> float:
    """Estimate the tools' travel between sections [m], the longer of both each time.

    A run of other tasks may begin and end at any of its targets. Unknown positions (seams, joint targets) count
    nothing.
    """
    home = {}
    if job.start != "free":
        q = np.array(job.start_joints)
        home = {name: model.tool_position(name, q)[None] for name in model.arms}
    places = [(home, home)] if home else []
    places += [_ends(list(model.arms), section) for section in sections]
    places += [(home, home)] if home and job.returns else []
    travel = 0.0
    for (_, leaves), (comes, _) in pairwise(places):
        shared_arms = set(leaves) & set(comes)
        travel += max((_distance(leaves[name], comes[name]) for name in shared_arms), default=0.0)
    return travel


def _ends(
    arms: Sequence[str], section: tuple[Task, ...]
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return a section's possible end positions by arm [m], shape (n, 3).

    They are the first and the last one.
    """
    first: dict[str, list[FloatArray]] = {}
    last: dict[str, list[FloatArray]] = {}
    for task in section:
        if task.path is not None and task.arm in task.path.paths:
            path = task.path.paths[task.arm]
            first.setdefault(task.arm, []).append(np.asarray(path.pose(0.0).translation))
            last.setdefault(task.arm, []).append(np.asarray(path.pose(path.length).translation))
        for stop in task.stops if task.path is None else ():
            if isinstance(stop.target, PoseTarget):
                place = np.asarray(stop.target.pose.translation)
                for name in filter(task.allows, arms):
                    first.setdefault(name, []).append(place)
                    last.setdefault(name, []).append(place)
    return (
        {name: np.array(rows) for name, rows in first.items()},
        {name: np.array(rows) for name, rows in last.items()},
    )


def _distance(points: FloatArray, others: FloatArray) -> float:
    """Compute the least distance between two sets of points [m]."""
    return float(norm(points[:, None] - others[None], axis=-1).min())


def quickest_of_sections(work: PlannedJob, watch: Watch) -> Schedule:
    """Plan several orders of a job's sections; return the fastest plan.

    Args:
        work: the resolved job, with paths or seams.
        watch: receives progress, and may end the search.

    Raises:
        InfeasibleError: no order has a plan; the reason is that of the file's order.
    """
    job = work.job
    if job.order == "given":
        return sections_plan(work, watch)
    watch.begin()
    orders = section_orders(work.model, job, work.effort.section_orders)
    if _has_open_runs(job):
        # Runs are ordered by estimates; the file's order of all tasks competes at the end.
        orders.append(replace(job, order="given"))
    best: Schedule | None = None
    failure: InfeasibleError | None = None
    longest, chosen, tried = 0.0, job, 0
    for number, order in enumerate(orders, start=1):
        if best is not None and watch.stop(longest):
            break
        begin = watch.elapsed()
        watch.count(number, len(orders))
        watch.report(f"planning order {number} of tasks of both arms")
        tried += 1
        try:
            schedule = sections_plan(work.with_job(order), watch)
        except InfeasibleError as error:
            failure = failure or error
            continue
        longest = max(longest, watch.elapsed() - begin)
        watch.record(schedule.duration)
        watch.keep(_with_order(schedule, order, orders[0], tried))
        if best is None or schedule.duration < best.duration:
            best, chosen = schedule, order
    if best is None:
        assert failure is not None  # there is at least the file's order
        raise failure
    return _with_order(best, chosen, orders[0], tried)


def _has_open_runs(job: Job) -> bool:
    """Return whether tasks between paths and seams have an open order."""
    return any(
        not section[0].alone and len({task.id for task in section}) > 1
        for section in job.sections()
    )


def _with_order(schedule: Schedule, chosen: Job, given: Job, tried: int) -> Schedule:
    """Append a note on the section order, if several were tried."""
    if tried < 2:
        return schedule
    rows = [
        "/".join(dict.fromkeys(task.id for task in section))
        if section[0].alone
        else f"{len({task.id for task in section})} others"
        for section in chosen.sections()
    ]
    source = "the file's order of sections" if chosen == given else "sections in another order"
    if chosen.order == "given":
        source = "the file's order of all tasks"
    note = order_note("sections", tried=tried, whose=source, rows=rows)
    return replace(schedule, notes=(*schedule.notes, note))
