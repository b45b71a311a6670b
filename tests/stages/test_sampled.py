"""The method `sampled`: its beam against brute force, and whole plans of arms without closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.plan.planner import plan, plan_without_bound
from dualarm_cli.postures.numeric_ways import NumericWays
from dualarm_cli.postures.sampled_stops import StopSamples
from dualarm_cli.stages.sampled_beam import beam_search
from dualarm_cli.stages.sampled_sequence import SampledSequence
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")
ARMS = ("left", "right")


def law(moved):
    """A time that grows with the slowest joint's way, and not linearly."""
    return np.sqrt(np.abs(moved).max(axis=-1))


def random_sequence(seed, free_start, returns):
    """Three stages, two platform angles, three samples of each arm at each; in the second only the left arm works."""
    rng = np.random.default_rng(seed)
    stages = []
    for k in range(3):
        stage = {}
        for arm in ARMS if k != 1 else ARMS[:1]:
            row, zero = np.repeat([0, 1], 3), np.zeros(6, dtype=np.int64)
            ways = NumericWays.at_targets(row, zero, np.zeros(6), zero, rng.uniform(-2, 2, (6, 2)))
            ways.ends[:] = rng.uniform(-2, 2, (6, 2, 2))
            stage[arm] = StopSamples(ways, rng.uniform(0.1, 1.0, 6))
        stages.append(stage)
    start = {arm: rng.uniform(-2, 2, 2) for arm in ARMS}
    angles = np.array([[0.0], [rng.uniform(0.5, 2.0)]])
    return SampledSequence(
        angles, stages, start, dict.fromkeys(ARMS, law), law, free_start, returns
    )


def length(problem, taken):
    """Time of one choice of samples, by the definition, stage by stage."""
    q, angle, total = dict(problem.start), problem.angles[0], 0.0
    first, first_angle = dict(problem.start), problem.angles[0]
    for k, (stage, own) in enumerate(zip(problem.stages, taken, strict=True)):
        here = problem.angles[stage["left"].ways.row[own["left"]]]
        longest = 0.0
        for arm, i in own.items():
            move = max(law(stage[arm].first[i] - q[arm]), law(here - angle))
            if problem.free_start and k == 0:
                move, first[arm], first_angle = 0.0, stage[arm].first[i], here
            longest = max(longest, move + stage[arm].work[i])
            q[arm] = stage[arm].last[i]
        angle, total = here, total + longest
    if problem.returns:
        back = [law(first[arm] - q[arm]) for arm in ARMS]
        total += max(*back, law(first_angle - angle))
    return total


@pytest.mark.parametrize("free_start", [False, True])
@pytest.mark.parametrize("returns", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_wide_beam_finds_the_best_of_all_sequences(seed, free_start, returns):
    """Against all 18 x 6 x 18 choices, both arms at one platform angle in every stage."""
    problem = random_sequence(seed, free_start, returns)
    options = [
        [
            {"left": i, "right": j}
            for i, j in itertools.product(range(6), repeat=2)
            if i // 3 == j // 3
        ],
        [{"left": i} for i in range(6)],
        [
            {"left": i, "right": j}
            for i, j in itertools.product(range(6), repeat=2)
            if i // 3 == j // 3
        ],
    ]
    least = min(length(problem, taken) for taken in itertools.product(*options))
    found = beam_search(problem, 10_000)
    # Of the ways into one state the best so far is kept, which a free start with a return does not allow.
    slack = 0.25 if free_start and returns else 1e-12
    assert least - 1e-12 <= length(problem, found) <= least + slack


def test_the_beam_has_no_plan_where_arms_share_no_platform_angle():
    """The left arm only at the first angle, the right one only at the second."""
    problem = random_sequence(0, False, False)
    stage = problem.stages[2]
    kept = {"left": stage["left"].take(np.arange(3)), "right": stage["right"].take(np.arange(3, 6))}
    apart = SampledSequence(
        problem.angles,
        [*problem.stages[:2], kept],
        problem.start,
        problem.arm_law,
        law,
        False,
        False,
    )
    assert beam_search(apart, 100) is None


@pytest.mark.parametrize("name", ["yumi", "nextage", "spherical"])
def test_any_arms_are_planned_and_verified_and_not_slower_than_greedily(
    general_robots, tmp_path, name
):
    """Seven axes with offsets; six without a spherical wrist on a waist; six with one. Nothing is named."""
    job = load_job(general_robots.write_cell(tmp_path, name))
    schedule = plan(job, QUICK)
    assert verify(schedule, job).passed
    assert schedule.lower_bound is None
    assert schedule.provenance.settings["platform"] == "sampled"
    assert schedule.provenance.settings["redundancy"] == "numeric"
    assert any("--platform sampled --redundancy numeric" in note for note in schedule.notes)
    assert any(note.startswith("lower bound: none") for note in schedule.notes)
    greedy = plan_without_bound(job, PlanSettings("fixed", effort="quick"))
    assert verify(greedy, job).passed
    assert schedule.duration <= greedy.duration + 1e-9


def test_the_same_job_has_the_same_plan_twice(general_robots, tmp_path):
    """Bit for bit."""
    job = load_job(general_robots.write_cell(tmp_path, "nextage", tasks=1))
    one, two = (plan_without_bound(job, QUICK).trajectory for _ in range(2))
    assert np.array_equal(one.position, two.position)


def test_free_starts_symmetry_free_yaw_joint_targets_and_idle_arms(general_robots, tmp_path):
    """All in one job."""
    file = general_robots.write_cell(tmp_path, "yumi")
    file.write_text(
        "dualarm: tasks/1\ncell: cell.yaml\nstart: free\nreturn: true\nspeed: 80%\n"
        "defaults: {approach: 40 mm, retract: 40 mm, dwell: 0.1 s}\ntasks:\n"
        "  - id: a\n    arm: left\n"
        "    pick:  {xyz: [0.3, 0.2, 0.1], rpy: [180 deg, 0, 0], free: yaw}\n"
        "    place: {xyz: [0.35, 0.3, 0.1], rpy: [180 deg, 0, 90 deg], symmetry: 4}\n"
        "  - {id: b, arm: right, move: {xyz: [0.35, -0.25, 0.1], rpy: [180 deg, 0, 0]}}\n"
        "  - {id: c, arm: left, move: {joints: [1.0, -0.2, -0.3, 0.7, 0.3, -0.15, 0.0]}}\n"
    )
    job = load_job(file)
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job).passed


def test_clearance_is_kept_by_any_arms(general_robots, tmp_path):
    """A post between pick and place of the left arm: proven clear, and it costs."""
    shapes = "{capsule: {radius: 30 mm, length: 60 mm}, xyz: [0, 0, 40 mm]}"
    post = "obstacles: [{name: post, box: [0.04, 0.04, 0.3], xyz: [0.33, 0.26, 0.2]}]\nclearance: 10 mm\n"
    job = load_job(general_robots.write_cell(tmp_path, "yumi", 1, shapes, post))
    schedule = plan_without_bound(job, QUICK)
    blind = plan_without_bound(job, QUICK, clear=False)
    assert not verify(blind, job, clearance=True).passed
    assert verify(schedule, job, clearance=True).passed
    assert schedule.clearance_cost == pytest.approx(schedule.duration - blind.duration)


@pytest.mark.parametrize("platform", ["sampled", "fixed"])
def test_a_target_out_of_reach_is_refused_with_its_place_and_miss(
    general_robots, tmp_path, platform
):
    """Task, arm, and how far: a spherical wrist on 0.4 and 0.4 m links, the tool 150 mm below it.

    The target 1.2 m ahead of the shoulder on its height is missed by sqrt(1.2² + 0.15²) - 0.8 m at least, which is
    what an arm stretched towards the wrist leaves.
    """
    file = general_robots.write_cell(tmp_path, "spherical", tasks=1)
    file.write_text(file.read_text().replace("[0.45, 0.2, 0.1]", "[1.2, 0.3, 0.4]"))
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(load_job(file), PlanSettings(platform, effort="quick"))
    message = str(caught.value)
    assert "task 'left 0': left arm cannot pick" in message
    miss = (np.hypot(1.2, 0.15) - 0.8) * 1000
    assert f"than {miss:.1f} mm" in message or f"than {miss + 0.1:.1f} mm" in message


def test_named_methods_that_do_not_serve_say_why(general_robots, tmp_path):
    """Only what nobody named is replaced."""
    job = load_job(general_robots.write_cell(tmp_path, "yumi", tasks=1))
    for settings, words in (
        (PlanSettings().naming(platform="sequence"), "--platform sequence does not serve YuMi"),
        (PlanSettings().naming(platform="exact"), "--platform exact does not serve YuMi"),
        (
            PlanSettings().naming(redundancy="arm_angle"),
            "--redundancy arm_angle does not serve YuMi",
        ),
    ):
        with pytest.raises(UnsupportedError) as caught:
            plan_without_bound(job, settings)
        assert words in str(caught.value)
        assert "left and right arms are not spherical-revolute-spherical" in str(caught.value)
        assert "--platform sampled" in str(caught.value)


def test_sampled_serves_arms_with_closed_forms_as_well(tasks_folder):
    """By numeric inverse kinematics of its own; not with arm angles."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    schedule = plan(job, PlanSettings(effort="quick").naming(platform="sampled"))
    assert verify(schedule, job).passed
    assert schedule.lower_bound <= schedule.duration
    with pytest.raises(UnsupportedError, match="leave out --redundancy arm_angle"):
        plan(job, PlanSettings().naming(platform="sampled", redundancy="arm_angle"))


def test_a_stop_without_lines_is_where_it_is_asked_on_a_platform_that_turns(tmp_path):
    """A waist that turns while an arm without closed forms goes to a bare target: its tool was once 60 mm off."""
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.plan.planner import plan_without_bound
    from dualarm_cli.verification import verify

    target = (
        "{xyz: [0.215455, -0.334051, 1.300075], quat: [0.951681, -0.205047, 0.228604, 0.000056]}"
    )
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: nextage\n")
    text = f"dualarm: tasks/1\ncell: cell.yaml\ntasks: [{{id: t, arm: right, move: {target}}}]\n"
    (tmp_path / "tasks.yaml").write_text(text)
    job = load_job(tmp_path / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick"), clear=False)
    verdict = verify(schedule, job)
    assert verdict.passed, verdict.failures
