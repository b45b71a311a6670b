"""Where should the tray stand? A notebook: moves a pick along the table, plans each place, draws the cycle time."""

# %%
import matplotlib.pyplot as plt

from dualarm_cli import InfeasibleError, load, plan

TASKS = "01_first_pick"  # a task file, or the name of a bundled job

# %% Change a target
cycles = {}
for x in (0.43, 0.45, 0.47):
    job = load(TASKS, {"tasks:/tasks/0/pick/xyz/0": x})
    try:
        found = plan(job, effort="quick")
    except InfeasibleError as error:
        print(f"x = {x:.2f} m: no plan: {error}")
        continue
    assert found.verified
    cycles[x] = found.cycle_time
    print(f"x = {x:.2f} m: {found.cycle_time:.3f} s")

# %% Plot
figure, (above, below) = plt.subplots(2)
above.plot(list(cycles), list(cycles.values()), "o-")
above.set(xlabel="pick at x [m]", ylabel="cycle time [s]")
samples = found.schedule.sample(rate=250)
for joint in found.schedule.robot.arms["left"].joints:
    below.plot(samples.time, samples.velocity[:, samples.joints.index(joint)], label=joint)
below.set(xlabel="time [s]", ylabel="velocity [rad/s]")
below.legend(ncols=4, fontsize="small")
figure.tight_layout()
figure.savefig("notebook.png")
