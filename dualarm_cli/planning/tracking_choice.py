"""Which posture follows a part on a conveyor: the one that was decided for a part that stands, or one like it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.srs_limits import wrap
from dualarm_cli.planning.tracking import Tracked, Tracking
from dualarm_cli.redundancy import StopPosture
from dualarm_cli.redundancy.problem import NoPosture
from dualarm_cli.redundancy.stop_batch import StopBatch
from dualarm_cli.redundancy.target_grid import target_postures


def followed_posture(asked: Tracking, near: Tracked | None) -> tuple[StopPosture, Tracked]:
    """Returns the posture that follows a part, and its motion: the decided one, else that most like it which does.

    Raises:
        InfeasibleError: none does; the words are those about the decided one.
    """
    try:
        return asked.posture, asked.solve(None if near is None else near.phases)
    except InfeasibleError as error:
        failure = error
    if isinstance(asked.problem.arm, GeneralArm):
        raise failure
    [others] = target_postures(StopBatch((asked.problem,)))
    if isinstance(others, NoPosture):
        raise failure
    made = asked.posture
    unlike = np.abs(wrap(others.psi - made.psi_target)) + np.abs(wrap(others.yaw - made.yaw))
    order = np.lexsort((unlike, others.branch != made.branch))
    columns = (others.target, others.yaw, others.branch, others.psi)
    for target, yaw, branch, psi in zip(*(column[order] for column in columns), strict=True):
        posture = replace(
            asked.posture,
            target=int(target),
            yaw=float(yaw),
            branch=int(branch),
            psi_target=float(psi),
            psi_approach=float(psi),
            psi_retract=float(psi),
        )
        try:
            return posture, replace(asked, posture=posture).solve()
        except InfeasibleError:
            continue
    raise failure
