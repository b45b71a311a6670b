"""How does the cell move? Draws joint speeds, the tool's path and its speed; a notebook as a script."""

# %% Plan a job
import matplotlib.pyplot as plt
import numpy as np

from dualarm_cli import load, plan

job = load("01_first_pick")  # a task file, or the name of a bundled job
result = plan(job, effort="quick")
schedule = result.schedule
assert result.verified

# %% Joint speeds, and the tool from above
figure, (speeds, path, tool) = plt.subplots(3, figsize=(8.0, 10.0), layout="constrained")
schedule.plot("velocity", axes=speeds)
times = np.linspace(0.0, schedule.duration, 400)
for arm in schedule.robot.arms:
    points = np.array([schedule.tool_pose(arm, time).translation for time in times])
    path.plot(points[:, 0], points[:, 1], label=arm)
path.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
path.legend()

# %% Tool speed, by the Jacobian
velocity = schedule.trajectory.at(times)[1]
for arm in schedule.robot.arms:
    twists = [schedule.jacobian(arm, t) @ rates for t, rates in zip(times, velocity, strict=True)]
    tool.plot(times, np.linalg.norm(np.array(twists)[:, :3], axis=1), label=arm)
tool.set(xlabel="time [s]", ylabel="tool speed [m/s]")
figure.savefig("curves.png")

# %% Who waits, and for what
print(f"cycle time {schedule.duration:.3f} s")
for wait in result.report["waits"]:
    print(f"{wait['arm']} waits {wait['length']:.3f} s: {wait['reason']}")
