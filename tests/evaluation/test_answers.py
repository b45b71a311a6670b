"""Answers: known ones first, the same request once, and none of files that changed in between."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.evaluation.answers import answers
from dualarm_cli.evaluation.fingerprint import hashes_now
from dualarm_cli.evaluation.store import Store
from dualarm_cli.model.studies.evaluation import Evaluation

ROBOT = "../../robots/planar/robot.yaml"


def reading(request):
    """An evaluation that has read the files as they are now."""
    inputs = hashes_now([ROBOT, "cell.yaml", "tasks.yaml"], request.folder, {})
    return Evaluation(request.case, "planned", cycle_time=1.0, inputs=inputs)


def changing(path=None, after=1):
    """A run in the middle of which a file changes; counts what it was asked."""

    def run(requests):
        for number, request in enumerate(requests):
            if path is not None and number == after:
                Path(path).write_text(Path(path).read_text() + "# changed\n")
            run.asked.append(request.case)
            yield number, reading(request)

    run.asked = []
    return run


@pytest.fixture
def three(cells, request_for):
    """Three requests of cells that have their robot in common."""
    return [request_for(case) for case in cells(3)]


def test_the_same_request_is_evaluated_once_and_known_ones_come_first(three, tmp_path):
    """With a store and without one."""
    a, b, c = three
    run = changing()
    found = list(answers([a, b, a, c, b], run, None))
    assert run.asked == [a.case, b.case, c.case]
    assert sorted(answer.index for answer in found) == [0, 1, 2, 3, 4]
    store, again = Store(tmp_path / "c"), changing()
    list(answers([b], again, store))
    found = list(answers([a, b, a], again, Store(tmp_path / "c")))
    assert again.asked == [b.case, a.case]
    assert [(answer.index, answer.from_store) for answer in found] == [
        (1, True),
        (0, False),
        (2, False),
    ]


def test_a_shared_file_that_changes_in_between_is_told(three, tmp_path):
    """By its name from the working directory; the next run plans anew what was planned before the change."""
    store = Store(tmp_path / "c")
    with pytest.raises(InputError, match=r"^robots/planar/robot.yaml: E500 has changed while"):
        list(answers(three, changing("robots/planar/robot.yaml"), store))
    again = changing()
    found = list(answers(three, again, Store(tmp_path / "c")))
    assert again.asked == [three[0].case, three[2].case]
    assert len(found) == 3


def test_a_file_that_changes_between_two_rounds_is_told(three):
    """As in a search, which asks again and again."""
    seen = {}
    list(answers(three[:1], changing(), None, seen))
    list(answers(three[:1], changing(), None, seen))
    Path("cells/000/cell.yaml").write_text("# other\n")
    with pytest.raises(InputError, match=r"cells/000/cell.yaml: E500 has changed"):
        list(answers(three[:1], changing(), None, seen))


def test_files_of_a_case_alone_may_differ_from_those_of_another(three):
    """Each has a cell file of its own, by the same name from its folder."""
    Path("cells/001/cell.yaml").write_text("# other\n")
    assert len(list(answers(three, changing(), None))) == 3
