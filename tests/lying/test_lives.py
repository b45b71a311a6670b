"""Lives of parts: where they lie from which event to which, by hand."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.model.lying import lying_parts, lying_throughout

A, B, C = (0.45, 0.15, 0.105), (0.45, 0.45, 0.105), (0.60, 0.45, 0.105)


def lives(job) -> list[tuple]:
    """Task and action, what begins it, what ends it, whether it is fed."""
    visits = [(task, stop) for task in job.tasks for stop in task.stops]
    return [
        (
            one.key[1:],
            one.since and one.since[1:],
            one.until and one.until[1:],
            one.fed,
        )
        for one in lying_parts(job, visits)
    ]


def test_a_part_waits_until_its_pick_and_lies_from_its_place_on(job_of, task):
    """One task: two places."""
    assert lives(job_of(task("one", A, B))) == [
        (("one", "pick"), None, ("one", "pick"), False),
        (("one", "place"), ("one", "place"), None, False),
    ]


def test_a_place_that_is_picked_from_again_is_fed(job_of, task):
    """The second part comes once the first one is put down, at the latest as the tool comes for it."""
    job = job_of(task("one", A, B), task("two", A, C))
    assert lives(job) == [
        (("one", "pick"), None, ("one", "pick"), False),
        (("two", "pick"), ("one", "place"), ("two", "pick"), True),
        (("one", "place"), ("one", "place"), None, False),
        (("two", "place"), ("two", "place"), None, False),
    ]


def test_what_is_picked_where_it_was_placed_is_the_same_part(job_of, task):
    """From the first arm's place to the other one's pick it lies there, once."""
    job = job_of(task("one", A, B), task("two", B, C, arm="right"))
    assert lives(job) == [
        (("one", "pick"), None, ("one", "pick"), False),
        (("one", "place"), ("one", "place"), ("two", "pick"), False),
        (("two", "place"), ("two", "place"), None, False),
    ]


def test_a_part_that_leaves_does_not_lie(job_of, task):
    """By the task's own key, or by the defaults but for a task that says otherwise."""
    job = job_of(task("one", A, B, ", leaves: true"))
    assert lives(job) == [(("one", "pick"), None, ("one", "pick"), False)]
    stays = task("two", C, A, ", leaves: false")
    job = job_of(task("one", A, B), stays, defaults=", leaves: true")
    assert [one[0] for one in lives(job) if one[0][1] == "place"] == [("two", "place")]


def test_a_part_without_shapes_and_a_target_by_joints_are_no_bodies(job_of, task):
    """Where its tool is at joint positions is not in the job."""
    still = "joints: [0, 10 deg, 0, -90 deg, 0, 60 deg, 0]"
    bare = f"{{id: bare, arm: left, pick: {{{still}}}, place: {{{still}}}}}"
    assert lives(job_of(bare)) == []
    job = job_of(task("one", A, B))
    [one] = job.tasks
    assert lives(replace(job, tasks=(replace(one, part=""),))) == []


def test_a_chute_moves_parts_on_and_a_buffer_at_one_place_keeps_them(job_of, task):
    """Placed above and picked below nothing lies above; below a part is there as the tool comes."""
    above, below = (0.55, 0.05, 0.3), (0.55, -0.05, 0.2)
    head = "buffers: {chute: {capacity: 2}}"
    put = task("put", A, above).replace(
        "0.7800], rpy: [180 deg, 0, 0]", "0.7800], rpy: [180 deg, 0, 0], buffer: chute"
    )
    take = task("take", below, C, arm="right").replace(
        "0.6800], rpy: [180 deg, 0, 0]", "0.6800], rpy: [180 deg, 0, 0], buffer: chute"
    )
    assert lives(job_of(put, take, head=head)) == [
        (("put", "pick"), None, ("put", "pick"), False),
        (("take", "pick"), None, ("take", "pick"), True),
        (("take", "place"), ("take", "place"), None, False),
    ]
    same = task("take", above, C, arm="right").replace(
        "0.7800], rpy: [180 deg, 0, 0]", "0.7800], rpy: [180 deg, 0, 0], buffer: chute"
    )
    assert lives(job_of(put, same, head=head))[1] == (
        ("put", "place"),
        ("put", "place"),
        ("take", "pick"),
        False,
    )


def test_what_is_handed_over_lies_at_both_ends_only(tasks_folder):
    """Picked by one arm, placed by the other one: in between one of them holds it."""
    from dualarm_cli.files.tasks.tasks import load_job

    job = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    assert [one[:3] for one in lives(job) if one[0][0] == "flip-1"] == [
        (("flip-1", "pick"), None, ("flip-1", "pick")),
        (("flip-1", "place"), ("flip-1", "place"), None),
    ]


def test_beside_a_section_lies_what_was_placed_before_and_what_is_picked_later(job_of, task):
    """Of the tasks themselves nothing: those of the section see to their own parts."""
    far = (0.30, 0.60, 0.105)
    job = job_of(
        task("one", A, B), task("two", C, far), task("three", (0.6, 0.2, 0.105), (0.7, 0.3, 0.105))
    )
    one, two, _ = job.tasks
    found = [(task.id, stop.action) for task, stop in lying_throughout(job, [one], [two])]
    assert sorted(found) == [("one", "place"), ("three", "pick")]
