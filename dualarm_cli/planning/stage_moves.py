"""How one joint group gets to where a stage's lines begin: standing, its transfer, and standing again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import WaitReason
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.bent_transfers import detour_pieces
from dualarm_cli.planning.stage_plan import StagePlan
from dualarm_cli.planning.transfers import PLATFORM, Transfers
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold


@dataclass(frozen=True)
class Move:
    """A stretch in which a group moves, or stands for one reason."""

    motion: Trajectory
    """What its joints do."""
    reason: WaitReason = ""
    """Why it stands; empty where it moves."""


def moves_to_lines(
    model: CellModel,
    plan: StagePlan,
    name: str,
    transfers: Transfers,
    together: Mapping[str, Trajectory],
    platform_end: float,
    columns: Mapping[str, list[int]],
    limits: JointLimits,
    timing: TimingSolver,
    cap: float | None,
    held: float = 0.0,
) -> list[Move]:
    """Returns what a group does from a stage's start until its lines begin, or until it has returned.

    Args:
        model: the cell.
        plan: the stage.
        name: the group.
        transfers: the stage's straight transfers.
        together: by group, where all joints move along one path.
        platform_end: when the platform is there, counted from the stage's start [s].
        columns: columns of each group within the limits' joints.
        limits: what the joints may do.
        timing: how transfers are timed.
        cap: largest speed of any tool centre point [m/s], or None.
        held: how long it stands first, for what a conveyor brings [s].
    """
    index = columns[name]
    joints = tuple(limits.joints[i] for i in index)
    late = plan.waits.get(name, 0.0)
    moves = [Move(hold(joints, plan.start[index], late), "shared_zone")] if late > 0.0 else []
    if held > 0.0:
        moves.insert(0, Move(hold(joints, plan.start[index], held), "conveyor"))
        late += held
    if name in together:
        moves.append(Move(together[name]))
    elif name in plan.detours:
        pieces = detour_pieces(
            model, plan, name, columns, limits, timing, cap, transfers.motion.get(PLATFORM)
        )
        moves += [Move(piece, "shared_zone" if _stands(piece) else "") for piece in pieces]
        # Its line begins when the platform is there as well.
        rest = platform_end - (late + sum(piece.duration for piece in pieces))
        if name in plan.stops and rest > 0.0:
            moves.append(Move(hold(joints, plan.arrival[index], rest), "platform"))
    elif name in transfers.motion:
        motion = transfers.motion[name]
        # An arm whose line begins where it is stands until the platform is there.
        moves.append(Move(motion, "platform" if _stands(motion) else ""))
    return moves


def _stands(motion: Trajectory) -> bool:
    return bool((motion.position == motion.position[0]).all() and not np.any(motion.velocity))
