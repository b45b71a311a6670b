"""Torques of an arm that follows a part on a conveyor."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.motion.torque_limits import least_slowing
from dualarm_cli.postures.stage_plan import ArmStop
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class TrackingTorques:
    """Torques of an arm with its loads before and after a stop, others at rest."""

    before: Dynamics
    """Dynamics before the held object changes."""
    after: Dynamics
    """Dynamics after it."""
    last: int
    """Number of the last phase before it."""
    columns: list[int]
    """Columns of the arm's joints."""
    joints: tuple[str, ...]
    """Names of all joints."""
    still: FloatArray
    """Positions of all joints at rest [rad or m], shape (n,)."""

    @classmethod
    def of(
        cls, cell: Cell, arm_stop: ArmStop, still: FloatArray, models: dict[object, Dynamics]
    ) -> TrackingTorques:
        """Prepare the stop of an arm.

        Args:
            cell: with efforts and masses.
            arm_stop: the stop.
            still: positions of all joints [rad or m], shape (n,).
            models: made so far, by arm and held object; completed.
        """
        task, action, robot = arm_stop.task, arm_stop.stop.action, cell.robot
        arm, held = arm_stop.arm, (task.held_before(action), task.held_after(action))
        for name in held:
            if (arm, name) not in models:
                models[arm, name] = Dynamics(cell, {arm: _weight(cell, arm, name)})
        before, after = (models[arm, name] for name in held)
        columns = robot.columns(robot.arm(arm).joints)
        # A part that is placed leaves at the end of the dwell.
        last = 2 if action == "place" else 1
        return cls(before, after, last, columns, robot.joints, still)

    def slowing(self, motion: Trajectory, phase: int) -> float:
        """Compute the least slowing factor of a phase.

        Args:
            motion: of the arm in the phase.
            phase: its number.

        Raises:
            InfeasibleError: a joint cannot hold still.
        """
        rates = np.zeros((3, len(motion.time), len(self.still)))
        rates[0] = self.still
        rates[:, :, self.columns] = motion.position, motion.velocity, motion.acceleration
        whole = Trajectory(self.joints, motion.time, *rates)
        factor, joint = least_slowing(self.before if phase <= self.last else self.after, whole)
        if not np.isfinite(factor):
            raise InfeasibleError(Refusal("conveyor_overload", data={"joint": self.joints[joint]}))
        return factor


def _weight(cell: Cell, arm: str, name: str) -> pin.Inertia:
    """Sum the inertias of a held object: changed tool and part, in the flange frame."""
    held, total = cell.all_held(arm)[name], pin.Inertia.Zero()
    if held.tool:
        total += cell.load_inertia(arm, Held(held.tool))
    return total + cell.load_inertia(arm, held) if held.part else total
