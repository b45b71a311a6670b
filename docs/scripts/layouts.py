"""Where should the robot stand? Plans a cell at many bases on all cores: python layouts.py [COUNT]."""

import sys

import numpy as np
import pinocchio as pin

from dualarm_cli import Plan, inverse_kinematics, load, plan_many

COUNT = int(sys.argv[1]) if len(sys.argv) > 1 else 50

# A job without files: the content of a cell file and of a task file.
cell = {
    "dualarm": "cell/1",
    "robot": "sda10f",
    "tools": {arm: {"tcp": {"xyz": [0, 0, "120 mm"]}} for arm in ("left", "right")},
}
down = ["180 deg", 0, 0]
tasks = {
    "dualarm": "tasks/1",
    "cell": cell,
    "tasks": [
        {
            "id": arm,
            "arm": arm,
            "pick": {"xyz": [0.45, side * 0.2, 0.8], "rpy": down},
            "place": {"xyz": [0.25, side * 0.55, 0.8], "rpy": down},
        }
        for arm, side in (("left", 1), ("right", -1))
    ],
}

# Bases in rows of ten, 20 mm apart; those from which no posture reaches a pick are not planned.
bases = [[0.02 * (k % 10) - 0.09, 0.02 * (k // 10) - 0.04, 0.0] for k in range(COUNT)]
jobs = {k: load(tasks, {"cell:/base": {"xyz": base}}) for k, base in enumerate(bases)}
picks = {
    arm: pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.45, side * 0.2, 0.8]))
    for arm, side in (("left", 1), ("right", -1))
}
near = {
    k: job
    for k, job in jobs.items()
    if all(len(inverse_kinematics(job, arm, pose)) for arm, pose in picks.items())
}
plans = plan_many(near.values(), effort="quick", progress=print)

times = {
    k: result.cycle_time
    for k, result in zip(near, plans, strict=True)
    if isinstance(result, Plan) and result.verified
}
print(f"{len(times)} of {COUNT} bases have a plan")
for k in sorted(times, key=times.__getitem__)[:5]:
    x, y, _ = bases[k]
    print(f"base at {x:+.2f}, {y:+.2f} m: {times[k]:.3f} s")
