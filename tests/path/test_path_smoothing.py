"""Self-motion evened out: kinks spread over the window, tools where they were, ends at rest as they were."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.path.context import PathClock, PathContext
from dualarm_cli.kinds.path.following import PathMotion
from dualarm_cli.kinds.path.motion import with_smooth_self_motion
from dualarm_cli.kinematics.cell_model import CellModel

TASKS = """\
dualarm: tasks/1
cell: cell.yaml
tasks:
  - id: seam
    arm: left
    path:
      speed: 100 mm/s
      through:
        - {xyz: [0.45, 0.25, 0.90], rpy: [180 deg, 0, 0]}
        - {xyz: [0.50, 0.25, 0.90]}
"""
WINDOW = 0.08


@pytest.fixture(scope="module")
def kinked(tmp_path_factory):
    """All joints of a robot at rest, one of which then moves at once, and back at once: three kinks in the middle."""
    folder = tmp_path_factory.mktemp("seam")
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    (folder / "tasks.yaml").write_text(TASKS)
    job = load_job(folder / "tasks.yaml")
    context = PathContext.of(CellModel.from_cell(job.cell), job)
    work = job.tasks[0].path
    start = np.random.default_rng(1).uniform(-0.5, 0.5, 15)
    problem = context.problem(work, start, PathClock.of(work))
    n = problem.instants
    time = np.arange(n) * problem.step
    # Out by 0.02 rad and back, each in a fifth of the time.
    out = 0.02 * np.clip(1.0 - np.abs(time / time[-1] - 0.5) / 0.2, 0.0, None)
    names = job.cell.robot.joints
    return SimpleNamespace(problem=problem, start=start, out=out, time=time, names=names)


def moved(kinked, *joints, times=1.0):
    """The motion in which these joints go out and back, perhaps several times as far."""
    position = np.repeat(kinked.start[None], len(kinked.time), axis=0)
    for joint in joints:
        position[:, kinked.names.index(joint)] += kinked.out * times
    return PathMotion(position)


def largest_acceleration(position, step):
    """Of any joint, by second differences."""
    return np.abs(np.diff(position, 2, axis=0)).max() / step**2


def test_a_kink_of_an_idle_arm_is_spread_over_the_window(kinked):
    """The speed's jump dv takes W: its acceleration is dv / W, and no joint but that one moves."""
    found = with_smooth_self_motion(kinked.problem, moved(kinked, "right_s"), WINDOW)
    column = kinked.names.index("right_s")
    others = np.delete(found.position, column, axis=1)
    assert np.abs(others - np.delete(kinked.start, column)).max() < 1e-9
    # At the top the speed changes from +v to -v with v = 0.02 rad in a fifth of the time.
    jump = 2.0 * 0.02 / (0.2 * kinked.time[-1])
    largest = largest_acceleration(found.position[:, [column]], kinked.problem.step)
    assert largest == pytest.approx(jump / WINDOW, rel=0.1)
    # Where it is straight the mean is the motion itself.
    k = int(np.argmin(np.abs(kinked.time / kinked.time[-1] - 0.4)))
    assert found.position[k, column] - kinked.start[column] == pytest.approx(0.01, abs=1e-4)


@pytest.mark.parametrize("joints", [("torso_b1",), ("left_e", "left_u", "torso_b1"), ("left_s",)])
@pytest.mark.parametrize("times", [1.0, 20.0])
def test_tools_stay_where_they_were(kinked, joints, times):
    """At every instant, whatever moves: position and rotation of the tool that follows.

    The mean moves a joint by at most v W / 4 = 2.5 mrad, or 50 mrad; two Newton steps with one Jacobian would leave the
    third power of that.
    """
    before = moved(kinked, *joints, times=times)
    after = with_smooth_self_motion(kinked.problem, before, WINDOW)
    body = kinked.problem.body
    (arm,) = np.flatnonzero(kinked.problem.follows)
    for one, other in zip(before.position[::7], after.position[::7], strict=True):
        (R, p), (R_after, p_after) = body.tools(one), body.tools(other)
        assert np.abs(p_after[arm] - p[arm]).max() < 1e-9
        assert np.abs(R_after[arm] - R[arm]).max() < 1e-9
    assert np.abs(after.position - before.position).max() > 1e-4


def test_both_ends_stay_as_they_are(kinked):
    """Bit by bit, even of a motion that is not at rest there, whose mean would be elsewhere."""
    ramp = np.linspace(0.0, 0.05, len(kinked.time))
    position = np.array(moved(kinked, "torso_b1").position)
    for joint in ("left_e", "right_s"):
        position[:, kinked.names.index(joint)] += ramp
    after = with_smooth_self_motion(kinked.problem, PathMotion(position), WINDOW)
    for k in (0, -1):
        assert after.position[k].tolist() == position[k].tolist()


def test_no_window_or_no_room_for_it_changes_nothing(kinked):
    """Zero, shorter than four instants, or longer than a sixth of the path."""
    before = moved(kinked, "torso_b1")
    for window in (0.0, 2.0 * kinked.problem.step, kinked.time[-1]):
        assert with_smooth_self_motion(kinked.problem, before, window) is before


def test_what_is_at_rest_stays_at_rest(kinked):
    """No joint moves: nothing is corrected either."""
    still = moved(kinked)
    found = with_smooth_self_motion(kinked.problem, still, WINDOW)
    assert np.abs(found.position - still.position).max() < 1e-15
