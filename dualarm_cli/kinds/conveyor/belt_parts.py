"""Parts that move with a belt, and bodies that come too near to them."""

from __future__ import annotations

import numpy as np

from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.stage_samples import KEPT, StageSamples, stage_samples
from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.quick_test import OVERLAP
from dualarm_cli.collision.rooms import RoomKey, rooms_of
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.motion.waiting import SAME_TIME
from dualarm_cli.refusals import Refusal


def touched_on_belt(job: Job, found: ClearedPlan) -> Refusal | None:
    """Find the first stage without clearance from a part on a belt, or None.

    On its lines, the tool that picks or places the part may touch it; up to its neighbouring stops no more than that.

    Args:
        job: decided, with its targets where they are met.
        found: its plan.
    """
    rooms = rooms_of(job, moving=True)
    motion, holding = found.cleared.motion, found.holding
    if not rooms or holding is None:
        return None
    cell = CellClearance.of(job.cell, job.carried(), rooms=rooms)
    events = {(e.task, e.action): e for e in motion.events}
    stage_of: dict[RoomKey, int] = {
        (stop.task.id, stop.stop.action): k
        for k, plan in enumerate(found.cleared.plans)
        for stop in plan.stops.values()
    }
    for k, stage in enumerate(motion.stages):
        samples = stage_samples(motion, k, k, holding)
        time = np.minimum(stage.start + samples.step * np.arange(len(samples.position)), stage.end)
        for r, room in enumerate(rooms):
            event = events[room.key]
            there = time < event.time - SAME_TIME
            if room.stop.action == "place":
                there = time >= event.changes_held
            assert room.stop.belt is not None  # it moves
            gone = (time - room.stop.belt.at)[:, None] * room.stop.belt.conveyor.velocity
            shift = np.einsum("ij,nj->ni", job.cell.base.rotation.T, gone)
            own = event.arm if stage_of[room.key] in (k, k - 1) else ""
            own_lines = stage_of[room.key] == k
            if worst := _worst(cell, r, samples, there, shift, own, own_lines):
                one, other, lack, row = worst
                more = {"one": one, "other": other, "when": float(time[row] - stage.start)}
                more |= {"stage": k + 1, "beside": [], "standing": [], "tried": []}
                return Refusal(
                    "stage_touches", room.stop.place, room.task.id, event.arm, lack, more=more
                )
    return None


def _worst(
    cell: CellClearance,
    r: int,
    samples: StageSamples,
    there: BoolArray,
    shift: FloatArray,
    own: str,
    own_lines: bool,
) -> tuple[str, str, float, int] | None:
    """Find the bodies that lack most clearance, the lack [m] and the row.

    None where all is clear. The arm of the part (own) may touch it, on its lines (own_lines: of this stage) at will.
    """
    for a, arm in enumerate(cell.arms):
        held = samples.held[:, a] % cell.size
        for number in np.unique(held[there]).tolist():
            rows = np.flatnonzero(there & (held == number))
            part = cell.part_of(number)
            margins, pairs = cell.test.drifting(r, arm, part, samples.position[rows], shift[rows])
            for margin, pair in zip(margins, pairs, strict=True):
                least = KEPT
                if arm == own and cell.test.is_on_flange(pair, arm):
                    room = cell.rooms[r]
                    needed = min(-OVERLAP, cell.test.needed(pair, arm, (room.task, room.stop)))
                    least = -np.inf if own_lines and number % 2 else needed - pair.required
                k = int(np.argmin(margin))
                if margin[k] < least:
                    return *cell.test.labels(pair), max(0.0, -float(margin[k])), int(rows[k])
    return None
