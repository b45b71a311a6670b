"""Where the gap between a blended plan and its lower bound lies.

python -m benchmarks.quality.bound_gap [--sequences 2] [--stages 24] [--effort thorough]

Plans of normal effort of random sequences, and four bounds, each by itself: on the cells of an effort; on cells half as
wide; on the first cells with the platform within 0.002 rad of the plan's angle in every stage; and with all joints at
the outer ends of lines within 0.01 rad of the plan's as well. The last one has no freedom left: what remains is how the
bound times motions, and how it counts arms that wait for each other.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from unittest.mock import patch

import numpy as np

from benchmarks.quality.blended_cycles import sequence_job
from benchmarks.quality.stage_barrier import estimated
from benchmarks.tables import print_head, print_row
from dualarm_cli.bound import bound
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.bound.layers import StopCells, StopReach, StopWork
from dualarm_cli.effort import EFFORTS, Resolution
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.times import Evaluated
from dualarm_cli.timing.transfer_table import PostureBoxes

ANGLE_ROOM = 0.002
"""How far platform angles may be from the plan's [rad]."""
JOINT_ROOM = 0.01
"""How far cells may be from the plan's joints [rad]."""


@dataclass(frozen=True)
class CellsNearPlan(StopCells):
    """Cells of a sequence at a plan's platform angles, and near its joints."""

    plan: Evaluated
    """The plan."""
    with_joints: bool
    """Whether cells must be near the plan's joints as well."""

    def reach(self, a: int, stage: int) -> StopReach:
        """Returns the reach of a stop, at the plan's platform angle alone."""
        reach = super().reach(a, stage)
        angle = self.plan.decisions.angle[stage]
        low = np.maximum(reach.span[0], angle - ANGLE_ROOM)
        high = np.minimum(reach.span[1], angle + ANGLE_ROOM)
        none = np.array([[np.inf], [-np.inf]])
        return replace(reach, span=np.where(low <= high, np.stack([low, high]), none))

    def work(self, a: int, stage: int, reach: StopReach) -> StopWork:
        """Returns the work at a stop, from and to cells near the plan's joints."""
        work = super().work(a, stage, reach)
        if not self.with_joints:
            return work
        postures = self.plan.arms[a]
        before = self._near(a, stage, work.approach, postures.q_approach[stage])
        after = self._near(a, stage, work.retract, postures.q_retract[stage])
        return replace(work, lines=replace(work.lines, before=before, after=after))

    def _near(self, a: int, stage: int, cells: PostureBoxes, joints: FloatArray) -> PostureBoxes:
        """Returns the cells near joints [rad], shape (joints,)."""
        q = np.append(joints, self.plan.decisions.angle[stage])[None]
        low, high = self.tables[a].box(q - JOINT_ROOM, q + JOINT_ROOM)
        rows = np.flatnonzero(((cells.low <= high) & (cells.high >= low)).all(axis=0))
        displacement = cells.displacement
        return replace(
            cells,
            index=cells.index[rows],
            kind=cells.kind[rows],
            low=np.ascontiguousarray(cells.low[:, rows]),
            high=np.ascontiguousarray(cells.high[:, rows]),
            line=cells.line[rows],
            displacement=None
            if displacement is None
            else np.ascontiguousarray(displacement[..., rows]),
        )


def bounds(job: Job, effort: str, plan: Evaluated) -> list[float]:
    """Returns the bounds of a blended job [s]: on an effort's cells, half as wide, and near the plan."""
    settings = EFFORTS[effort]
    cells = settings.passing_bound
    finer = replace(cells, step=0.5 * cells.step, arm_angles=2 * cells.arm_angles)

    def value(resolution: Resolution) -> float:
        of_effort = {effort: replace(settings, passing_bound=resolution)}
        with patch.object(bound, "EFFORTS", of_effort):
            found = job_bound(job, effort, "lines").value
        assert found is not None and np.isfinite(found)  # these sequences have bounds
        return found

    values = [value(cells), value(finer)]
    for with_joints in (False, True):
        near = partial(CellsNearPlan, plan=plan, with_joints=with_joints)
        with patch.object(bound, "StopCells", near):
            values.append(value(cells))
    return values


def main() -> None:
    """Prints one row per sequence."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--sequences", type=int, default=2)
    parser.add_argument("--stages", type=int, default=24)
    parser.add_argument("--effort", choices=[*EFFORTS], default="thorough")
    given = parser.parse_args()
    near = "at the plan's platform angles", "near all its joints"
    print_head("sequence", "cycle", "gap", "on cells half as wide", *near)
    for seed in range(1, given.sequences + 1):
        job = sequence_job(seed, given.stages)
        cycle, _, plan = estimated(job)
        gaps = [1.0 - value / cycle for value in bounds(job, given.effort, plan)]
        print_row(seed, f"{cycle:.3f} s", *(f"{gap:.1%}" for gap in gaps))


if __name__ == "__main__":
    main()
