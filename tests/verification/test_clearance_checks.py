"""Which bodies must keep apart, what a carried part may do, and what the check says."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import Pair, cell_solids, pairs_that_must_keep_apart
from dualarm_cli.evaluation.evaluate import evaluation_of
from dualarm_cli.files.robots.meshes import read_hull
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.interface import Plan
from dualarm_cli.kinds.seam.checks import seam_touches
from dualarm_cli.model.cell import Obstacle
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Task
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Shape
from dualarm_cli.model.verification import exceptions, nearest
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.console import summary_lines
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify
from dualarm_cli.verification.clearance_checks import _add_plain, touching_spans
from dualarm_cli.verification.measuring.holding_spans import carrying_spans, spans_on_lines


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """One part of each arm from tray to carton, without a clearance beyond contact."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    tasks = [next(t for t in job.tasks if t.arm == arm) for arm in ("left", "right")]
    cell = dataclasses.replace(job.cell, clearance=0.0)
    return dataclasses.replace(job, tasks=tuple(tasks), cell=cell)


@pytest.fixture(scope="module")
def schedule(packing):
    """Its plan with the platform held."""
    return plan_without_bound(packing, PlanSettings(platform="fixed"))


def in_cell(job, **changes):
    """The job in another cell."""
    return dataclasses.replace(job, cell=dataclasses.replace(job.cell, **changes))


def collisions(schedule, job):
    """The check, and the stages' clearances."""
    found = verify(schedule, job, clearance=True)
    [check] = [check for check in found.checks if check.name == "collisions"]
    return check, found.clearances


def bodies_in_pairs(cell):
    """Names of all pairs of bodies that must keep apart."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    solids = cell_solids(cell, model, [])
    pairs = pairs_that_must_keep_apart(model, solids, cell)
    return {frozenset((solids[p.first].body, solids[p.second].body)): p for p in pairs}


def test_a_cylinder_between_two_balls_is_the_capsule_that_it_is(packing):
    """SDA10F: pedestal, torso, two arms of seven links; fourteen bodies of one capsule, flanges of one ball."""
    model = pin.buildModelFromXML(packing.cell.robot.urdf)
    solids = cell_solids(packing.cell, model, [])
    kinds = [type(s.geometry).__name__ for s in solids if s.body.endswith(("_link_s", "_link_u"))]
    assert kinds == ["Capsule"] * 4
    assert sorted(s.body for s in solids if s.body.startswith("left_link")) == [
        f"left_link_{x}" for x in "belrstu"
    ]


def test_neighbours_and_named_contacts_are_left_out_and_nothing_else(packing):
    """Links joined by one joint, what never moves against each other, and the robot's own list."""
    pairs = bodies_in_pairs(packing.cell)
    absent = [
        ("left_link_s", "left_link_l"),
        ("left_link_t", "left_tool"),
        ("left_link_b", "left_tool"),
        ("base_link", "torso_link_b1"),
        ("base_link", "table"),
        ("torso_link_b1", "left_link_l"),
    ]
    present = [
        ("left_link_s", "left_link_e"),
        ("left_tool", "right_tool"),
        ("left_link_u", "table"),
        ("base_link", "left_link_u"),
        ("torso_link_b1", "table"),
    ]
    assert not [names for names in absent if frozenset(names) in pairs]
    assert not [names for names in present if frozenset(names) not in pairs]
    allowed = dataclasses.replace(packing.cell, allowed_contacts=(("left_tool", "right_tool"),))
    assert set(pairs) - set(bodies_in_pairs(allowed)) == {frozenset(("left_tool", "right_tool"))}


def test_the_other_robots_base_is_no_neighbour(tasks_folder):
    """Two iiwas: each first link hangs on its own base alone, though both bases stand in the world."""
    pairs = bodies_in_pairs(load_job(tasks_folder / "05_two_robots" / "tasks.yaml").cell)
    for own, other in (("left", "right"), ("right", "left")):
        assert frozenset((f"{own}_base_link", f"{own}_link_1")) not in pairs
        assert frozenset((f"{other}_base_link", f"{own}_link_1")) in pairs


def test_a_pair_has_its_own_clearance_where_the_cell_says_so(packing):
    """All others keep the cell's."""
    cell = dataclasses.replace(
        packing.cell, clearance=0.01, clearances=(("left_tool", "table", 0.003),)
    )
    pairs = bodies_in_pairs(cell)
    assert pairs[frozenset(("left_tool", "table"))].required == 0.003
    assert pairs[frozenset(("right_tool", "table"))].required == 0.01


def test_a_plan_without_contact_passes_and_names_the_nearest_of_every_stage(schedule, packing):
    """Certified, stage by stage; asked for only."""
    check, stages = collisions(schedule, packing)
    assert check.verdict == "passed"
    assert [stage.stage for stage in stages if not stage.near] == list(range(len(schedule.stages)))
    assert all(stage.clearance == pytest.approx(stage.margin + stage.required) for stage in stages)
    [unasked] = [c for c in verify(schedule, packing).checks if c.name == "collisions"]
    assert unasked.verdict == "not checked"


def test_near_links_do_not_hide_what_a_cell_can_change(schedule, packing):
    """The least of all other pairs is that of a cell in which near links, by the URDF's joints, may touch."""
    model = pin.buildModelFromXML(packing.cell.robot.urdf)
    above = {f.name: set(model.supports[f.parentJoint]) for f in model.frames}
    above |= {f"{arm.name}_tool": above[arm.flange] for arm in packing.cell.robot.arms}
    near = [
        tuple(pair)
        for pair in bodies_in_pairs(packing.cell)
        if pair <= set(above) and len(set.symmetric_difference(*(above[b] for b in pair))) <= 3
    ]
    _, stages = collisions(schedule, packing)
    _, expected = collisions(schedule, in_cell(packing, allowed_contacts=tuple(near)))
    hidden = [stage for stage in stages if stage.near]
    assert hidden
    assert all(stage.bodies in near or stage.bodies[::-1] in near for stage in hidden)
    assert [stage for stage in stages if not stage.near] == list(expected)
    least = nearest(stages)
    assert least == min(expected, key=lambda stage: stage.margin)
    assert min(stages, key=lambda stage: stage.margin) in hidden
    missed = dataclasses.replace(hidden[0], margin=-1e-4)
    assert nearest([*stages, missed]) == missed
    assert nearest(hidden) in hidden
    assert nearest([]) is None
    verified = dataclasses.replace(schedule, verification=verify(schedule, packing, clearance=True))
    report = build_report(verified, packing)
    assert tuple(report["smallest_clearance"]["bodies"]) == least.bodies
    assert tuple(report["near_links"]["bodies"]) in {stage.bodies for stage in hidden}
    assert (
        f"{' and '.join(least.bodies)} at {least.time:.3f} s; near links: " in report["collisions"]
    )


def test_bodies_without_a_shape_are_named(schedule, packing):
    """A left tool that reaches out and has no shape; one of a robot of whose right arm only the frames are known."""
    assert "shapes" not in [
        check.name for check in verify(schedule, packing, clearance=True).checks
    ]
    tools = {
        **packing.cell.tools,
        "left": dataclasses.replace(packing.cell.tools["left"], shapes=()),
    }
    robot = packing.cell.robot
    bare = re.sub(
        r'(<link name="right_[^"]*">).*?</link>', r"\1</link>", robot.urdf, flags=re.DOTALL
    )
    job = in_cell(packing, tools=tools, robot=dataclasses.replace(robot, urdf=bare))
    found = verify(schedule, job, clearance=True)
    [check] = [check for check in found.checks if check.name == "shapes"]
    assert check.verdict == "not checked"
    assert check.detail == "no shapes of the right arm's links, left_tool"
    assert found.passed
    caveat = "collisions could not be fully checked: no shapes of the right arm's links, left_tool"
    assert found.caveats == (caveat,)
    assert exceptions(found.caveats) == f", except that {caveat}"
    whole = verify(schedule, packing, clearance=True)
    assert (whole.caveats, exceptions(whole.caveats)) == ((), "")
    [unasked] = verify(schedule, packing).caveats
    assert unasked.startswith("collisions were not checked: not requested")
    judged = dataclasses.replace(schedule, verification=found)
    report = build_report(judged, job)
    assert report["verification"]["caveats"] == [caveat]
    assert report["collisions"].startswith("none between bodies with shapes; least")
    assert f" checks), except that {caveat}; assumed: " in summary_lines(report)[-1]
    assert Plan(job, judged).caveats == (caveat,)
    assert evaluation_of("a", Plan(job, judged)).caveats == (caveat,)


def test_a_stage_without_length_is_left_out_and_the_others_keep_their_numbers(packing):
    """From a free start the first bare move takes no time: the second stage is called the second."""
    task = packing.tasks[0]
    stops = tuple(
        dataclasses.replace(stop, approach=0.0, retract=0.0, dwell=Dwell()) for stop in task.stops
    )
    job = dataclasses.replace(
        packing, tasks=(dataclasses.replace(task, stops=stops),), start="free", returns=False
    )
    found = plan_without_bound(job, PlanSettings(platform="fixed"))
    assert found.stages[0].end == found.stages[1].start == 0.0
    _, stages = collisions(found, job)
    assert {stage.stage for stage in stages} == {1}


def test_an_obstacle_in_the_way_is_found_with_pair_time_and_depth(schedule, packing):
    """A ball of 20 mm in the middle of the left tool's cap of 30 mm, at its first event: 50 mm to get out."""
    event = next(e for e in schedule.events if e.arm == "left")
    place = event.pose.act(np.array([0.0, 0.0, -0.03]))
    ball = Obstacle("ball", Shape("sphere", (0.02,), pin.SE3(np.eye(3), place)))
    check, stages = collisions(schedule, in_cell(packing, obstacles=(ball,)))
    assert check.verdict == "failed"
    assert "left_tool and ball" in check.detail
    # The cap ends at the tip, so that its middle is 30 mm above it.
    assert check.measured == pytest.approx(0.05, abs=1e-3)
    assert stages[0].time == pytest.approx(event.time, abs=0.2)


@pytest.mark.parametrize(
    "shape",
    [
        Shape("box", (0.04, 0.04, 0.04), pin.SE3.Identity()),
        Shape("capsule", (0.02, 0.05), pin.SE3.Identity()),
        Shape("cylinder", (0.02, 0.04), pin.SE3.Identity()),
    ],
)
def test_every_kind_of_solid_is_seen(schedule, packing, shape):
    """All 20 mm to the side, in the middle of the tool's cap of 30 mm, their axes along the tool's."""
    event = next(e for e in schedule.events if e.arm == "left")
    pose = event.pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.03]))
    obstacle = Obstacle("solid", dataclasses.replace(shape, pose=pose))
    check, _ = collisions(schedule, in_cell(packing, obstacles=(obstacle,)))
    assert check.verdict == "failed"
    assert check.measured == pytest.approx(0.05, abs=1.5e-3)


def test_a_half_space_is_everything_below(schedule, packing):
    """Its plane 5 mm above the lowest event: the tools' shapes end at their tips. And 5 mm below it."""
    lowest = min(event.pose.translation[2] for event in schedule.events)
    for above, verdict in ((0.005, "failed"), (-0.005, "passed")):
        plane = pin.SE3(np.eye(3), np.array([0.0, 0.0, lowest + above]))
        floor = Obstacle("floor", Shape("half_space", (), plane))
        check, _ = collisions(schedule, in_cell(packing, obstacles=(floor,)))
        assert check.verdict == verdict
    check, stages = collisions(schedule, in_cell(packing, obstacles=(floor,)))
    assert min(stage.clearance for stage in stages) <= 0.005


def test_a_mesh_is_its_convex_hull(schedule, packing, tmp_path):
    """A tetrahedron around the tool's cap as a file."""
    event = next(e for e in schedule.events if e.arm == "left")
    file = tmp_path / "solid.obj"
    file.write_text(
        "v 0 0 -100\nv 100 0 50\nv -50 80 50\nv -50 -80 50\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"
    )
    pose = pin.SE3(np.eye(3), event.pose.act(np.array([0.0, 0.0, -0.03])))
    hull = read_hull(file, file.name, np.full(3, 1e-3))
    mesh = Obstacle("mesh", Shape("mesh", (), pose, hull))
    check, _ = collisions(schedule, in_cell(packing, obstacles=(mesh,)))
    assert check.verdict == "failed"
    assert "mesh" in check.detail


def carried(packing, length, **changes):
    """The job with parts: rods that hang from the tips."""
    rod = Shape("box", (0.04, 0.04, length), pin.SE3(np.eye(3), np.array([0.0, 0.0, length / 2])))
    job = in_cell(packing, parts={"rod": (rod,)}, **changes)
    return dataclasses.replace(
        job, tasks=tuple(dataclasses.replace(task, part="rod") for task in job.tasks)
    )


def test_a_part_belongs_to_its_arm_from_pick_to_place(schedule, packing):
    """A rod that reaches a table below hits it in the transfer; the bare tool does not."""
    clear, _ = collisions(schedule, carried(packing, 0.02))
    assert clear.verdict == "passed"
    # Tips are 60 to 100 mm above the table at the events and 80 mm higher on the way.
    check, _ = collisions(schedule, carried(packing, 0.30))
    assert check.verdict == "failed"
    assert "rod" in check.detail
    assert collisions(schedule, packing)[0].verdict == "passed"


def test_a_part_may_lie_on_what_it_is_taken_from_and_put_on_but_not_reach_into_it(
    schedule, packing
):
    """A plate just below the rod at the pick: contact is no fault there, two millimetres more are one."""
    event = next(e for e in schedule.events if e.arm == "left" and e.action == "pick")
    for deeper, verdict in ((0.0, "passed"), (0.002, "failed")):
        top = event.pose.translation - np.array([0.0, 0.0, 0.02 - deeper])
        pose = pin.SE3(np.eye(3), top - np.array([0.0, 0.0, 0.005]))
        plate = Obstacle("plate", Shape("box", (0.06, 0.06, 0.01), pose))
        job = carried(packing, 0.02, obstacles=(plate,), clearance=0.002)
        job = in_cell(job, allowed_contacts=tuple(_own_pairs(job)))
        assert collisions(schedule, job)[0].verdict == verdict


def _own_pairs(job):
    """All pairs but those with the plate: they are not what is asked."""
    return [tuple(names) for names in bodies_in_pairs(job.cell) if "plate" not in names]


def left_open(job):
    """The same job, arms and order left to the planner."""
    tasks = tuple(dataclasses.replace(task, arm="any") for task in job.tasks)
    return dataclasses.replace(job, tasks=tasks, order="optimise")


@pytest.mark.parametrize("length", [0.02, 0.30])
def test_a_part_of_a_task_of_any_arm_belongs_to_the_arm_that_did_it(schedule, packing, length):
    """Rods clear of the table and rods that hit it: just as where the file says which arm."""
    job = carried(packing, length)
    given, opened = collisions(schedule, job), collisions(schedule, left_open(job))
    assert given == opened
    assert given[0].verdict == ("passed" if length < 0.1 else "failed")


def _short_of_clearance(packing):
    """The rods' job with 200 mm asked of the rods from the table, and nothing else asked: the transfers have less."""
    job = carried(packing, 0.02)
    kept = ("left rod", "right rod", "rod", "table")
    others = [names for names in bodies_in_pairs(job.cell) if not set(names) <= set(kept)]
    return in_cell(job, clearance=0.2, allowed_contacts=tuple(tuple(names) for names in others))


KINDS = ("transfer", "approach", "dwell", "retract", "wait", "return", "path", "seam")


@pytest.mark.parametrize("kind", KINDS)
def test_no_name_of_a_segment_makes_room_for_a_part(schedule, packing, kind):
    """Every segment called something else, alone and all together: the same distance, the same pair and time.

    Where a part may lie on something follows from its events and the motion. Paths and seams end the time in which a
    tool may touch its own part: their names find more.
    """
    job = _short_of_clearance(packing)
    expected, _ = collisions(schedule, job)
    assert expected.verdict == "failed"

    def is_kept(segments) -> bool:
        found, _ = collisions(dataclasses.replace(schedule, segments=segments), job)
        stricter = kind in ("path", "seam") and found.measured > expected.measured
        return found == expected or stricter

    segments = schedule.segments
    for k in range(len(segments)):
        named = tuple(
            dataclasses.replace(s, kind=kind) if n == k else s for n, s in enumerate(segments)
        )
        relabelled = dataclasses.replace(schedule, segments=named)
        # The name itself is a finding, too.
        assert verify(relabelled, job).passed == (segments[k].kind == kind)
        if k % 7 == 0:
            assert is_kept(named)
    assert is_kept(tuple(dataclasses.replace(s, kind=kind) for s in segments))
    assert collisions(dataclasses.replace(schedule, segments=()), job)[0] == expected


def test_a_part_that_nobody_picks_is_carried_by_nobody(schedule, packing):
    """The left arm's task is not done: its long rod is nowhere, the right arm's still hits the table."""
    job = left_open(carried(packing, 0.30))
    events = tuple(event for event in schedule.events if event.arm != "left")
    check, _ = collisions(dataclasses.replace(schedule, events=events), job)
    assert check.verdict == "failed"
    only = dataclasses.replace(job, tasks=(job.tasks[0],))
    check, _ = collisions(dataclasses.replace(schedule, events=events), only)
    assert check.verdict == "passed"


def test_stages_that_overlap_have_each_the_least_of_their_own_time(schedule, packing):
    """One stage over all the motion has the least of all; others, given with it, keep their own."""
    job = dataclasses.replace(packing, mode="free")
    _, apart = collisions(schedule, packing)
    whole = dataclasses.replace(
        schedule.stages[0], start=0.0, end=schedule.duration, tasks=(), arm="right"
    )
    left = [dataclasses.replace(stage, arm="left") for stage in schedule.stages]
    both = dataclasses.replace(schedule, stages=(whole, *left))
    _, found = collisions(both, job)
    assert {stage.stage for stage in found} == set(range(len(schedule.stages) + 1))
    later = [stage for stage in found if stage.stage]
    assert [stage.margin for stage in later] == pytest.approx([s.margin for s in apart])
    for near in (False, True):
        [first] = [s for s in found if s.near is near and not s.stage]
        assert first.margin == min(s.margin for s in later if s.near is near)


def test_motion_between_stages_is_proven_too(schedule, packing):
    """A ball at the first event, which lies in no stage: the motion is judged, whatever the stages leave out."""
    event = next(e for e in schedule.events if e.arm == "left")
    place = event.pose.act(np.array([0.0, 0.0, -0.03]))
    ball = Obstacle("ball", Shape("sphere", (0.02,), pin.SE3(np.eye(3), place)))
    job = dataclasses.replace(in_cell(packing, obstacles=(ball,)), mode="free")
    late = [stage for stage in schedule.stages if stage.start > event.time]
    early = dataclasses.replace(schedule.stages[0], end=1e-3, tasks=())
    check, found = collisions(dataclasses.replace(schedule, stages=(early, *late)), job)
    assert check.verdict == "failed"
    assert check.measured == pytest.approx(0.05, abs=1e-3)
    assert found[0].stage == 0
    assert found[0].margin == pytest.approx(-0.05, abs=1e-3)


def test_what_a_tool_works_on_counts_at_every_instant():
    """From the first knot to the last: with its clearance before and after the work, as a contact meanwhile."""
    time = np.array([0.0, 0.5, 3.0, 5.0])
    schedule = SimpleNamespace(trajectory=SimpleNamespace(time=time))
    pairs, windows = [], []
    _add_plain(pairs, windows, Pair(3, 4, 0.01), [(1.0, 2.0)], schedule)
    assert pairs == [Pair(3, 4, 0.01), Pair(3, 4, -5e-4)]
    assert windows == [[(0.0, 1.0), (2.0, 5.0)], [(1.0, 2.0)]]
    pairs, windows = [], []
    _add_plain(pairs, windows, Pair(3, 4, 0.01), [], schedule)
    assert (pairs, windows) == ([Pair(3, 4, 0.01)], [None])


def test_a_tool_may_touch_any_of_what_its_seam_names():
    """Of two bodies each by itself, from the approach to the end of the retract; nothing else, and no other tool."""
    work = SimpleNamespace(slave="left", touches=("left_tool", "jig", "right_tool"))
    job = SimpleNamespace(tasks=[SimpleNamespace(id="weld", arm="left", seam=work)])

    def span(action, start, end):
        event = SimpleNamespace(arm="left", task="weld", action=action, time=0.5 * (start + end))
        return SimpleNamespace(event=event, start=start, end=end, dwell_end=event.time)

    spans = [span("seam_start", 1.0, 2.0), span("seam_end", 3.0, 4.0)]

    def worked(one, other, spans):
        solids = (SimpleNamespace(carrier="", body=body) for body in (one, other))
        return touching_spans(seam_touches(job, spans), *solids)

    for body, found in (("jig", [(1.0, 4.0)]), ("right_tool", [(1.0, 4.0)]), ("table", [])):
        assert worked("left_tool", body, spans) == found
        assert worked(body, "left_link_t", spans) == []
    # Done twice, or the end before the start, it makes no room at all.
    assert worked("left_tool", "jig", [*spans, spans[0]]) == []
    assert worked("left_tool", "jig", [span("seam_start", 5, 6), spans[1]]) == []


def test_lines_that_follow_on_or_overlap_are_one_span():
    """Five spans of one part, three at one another; another arm's, another task's and a hand-over's do not count."""
    job = SimpleNamespace(tasks=[Task("a", "left", (), part="rod"), Task("b", "left", ())])
    solid = SimpleNamespace(carrier="left", body="rod", tool="", bolted=False)

    def span(start, end, arm="left", task="a", action="pick"):
        event = SimpleNamespace(arm=arm, task=task, action=action)
        return SimpleNamespace(event=event, start=start, end=end)

    spans = [span(4, 5), span(0, 1), span(2, 3), span(2.5, 2.8, action="place"), span(3, 3.5)]
    others = [span(6, 7, arm="right"), span(6, 7, task="b"), span(6, 7, action="give")]
    assert spans_on_lines(job, solid, [*spans, *others]) == [(0, 1), (2, 3.5), (4, 5)]


def test_what_is_never_put_down_is_carried_to_the_end():
    """A part that is picked and not placed, and a tool that is on from the start: to the last knot."""
    cell = SimpleNamespace(start_tool=lambda arm: "claw")
    task = Task("a", "left", (), part="rod", tool="claw")
    job = SimpleNamespace(cell=cell, tasks=[task])
    pick = SimpleNamespace(arm="left", task="a", action="pick", time=1.0, changes_held=1.0)
    motion = SimpleNamespace(time=np.array([0.0, 2.0, 5.0]))
    schedule = SimpleNamespace(trajectory=motion, events=(pick,))
    rod = SimpleNamespace(carrier="left", body="rod", tool="claw", bolted=False)
    claw = SimpleNamespace(carrier="left", body="left_claw", tool="claw", bolted=True)
    assert carrying_spans(schedule, job, rod) == [(1.0, 5.0)]
    assert carrying_spans(schedule, job, claw) == [(0.0, 5.0)]
