"""Studies carried out: rows in order, nothing twice, going on after an end, failures beside results."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from dualarm_cli.evaluation.fingerprint import names_of
from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.files.source.text_source import read_bytes, recorded_reads
from dualarm_cli.model.studies.evaluation import Evaluation, Finding
from dualarm_cli.studies.document import study_document
from dualarm_cli.studies.rows import StudyRow, rank
from dualarm_cli.studies.search import Desk, study_points


def _bowl(a=0.0, b=0.0):
    """Cycle time and clearance of a point; no plan beyond a + b > 5."""
    if a + b > 5:
        return None
    return {
        "cycle_time": 1 + (a - 2) ** 2 + (b - 1) ** 2,
        "clearance": 0.01 * a,
        "gap": 0.1,
        "travel": b,
    }


def test_rows_are_in_the_order_of_the_points_whatever_ends_first(
    make_study, counting, desk
) -> None:
    """Forwards and backwards the same rows."""
    study = make_study(a=[0, 1, 2, 3], b=[0, 1, 4])
    points = study_points(study)
    rows = desk(counting(_bowl)).rows(study, points)
    assert [row.point for row in rows] == points
    assert rows == desk(counting(_bowl, backwards=True)).rows(study, points)
    assert [row.status for row in rows].count("infeasible") == 1 + 1
    assert [row.number for row in rows] == list(range(12))


def test_progress_counts_up_to_all_points_and_knows_the_best(make_study, counting) -> None:
    """The best never gets worse."""
    study = make_study(a=[0, 1, 2, 3], b=[4, 1])
    told = []
    Desk(counting(_bowl), None, told.append).rows(study, study_points(study))
    assert [p.done for p in told] == list(range(1, 9))
    assert {p.of for p in told} == {8}
    best = [p.best.figures["cycle_time"] for p in told if p.best]
    assert best == sorted(best, reverse=True)
    assert best[-1] == 1.0


class _Files:
    """A job whose one file exists, so that answers can be kept."""

    def __init__(self, folder, counting):
        self.path = folder / "tasks.yaml"
        self.path.write_text("dualarm: tasks/1\n")
        outer = self

        class Run(counting):
            def answer(self, request: Request, values) -> Evaluation:
                with recorded_reads() as record:
                    read_bytes(outer.path, "tasks.yaml")
                return replace(
                    super().answer(request, values), inputs=names_of(record, request.folder)
                )

        self.run = Run(_bowl)


def test_nothing_is_evaluated_twice(make_study, counting, store, tmp_path, monkeypatch) -> None:
    """Ended in the middle, then gone on with, then run again, then made longer."""
    monkeypatch.chdir(tmp_path)
    files = _Files(tmp_path, counting)
    study = make_study(a=[0, 1, 2], b=[0, 1, 3])
    points = study_points(study)
    files.run.stop_after = 4
    with pytest.raises(KeyboardInterrupt):
        Desk(files.run, store).rows(study, points)
    files.run.stop_after = None
    desk = Desk(files.run, store)
    rows = desk.rows(study, points)
    assert (desk.from_store, desk.planned) == (4, 5)
    asked = [tuple(sorted(values.items())) for values in files.run.asked]
    assert len(asked) == len(set(asked)) == 9
    again = Desk(files.run, store)
    assert again.rows(study, points) == rows
    assert (again.from_store, again.planned) == (9, 0)
    longer = make_study(a=[0, 1, 2, 3], b=[0, 1, 3])
    more = Desk(files.run, store)
    more.rows(longer, study_points(longer))
    assert (more.from_store, more.planned) == (9, 3)
    # Another content of the file is another job.
    files.path.write_text("dualarm: tasks/1 # changed\n")
    other = Desk(files.run, Store(store.folder))
    other.rows(study, points)
    assert (other.from_store, other.planned) == (0, 9)


def test_the_files_as_they_are_are_planned_without_replacements(make_study, counting, desk) -> None:
    """And are no row."""
    study = make_study(a=[1, 2])
    run = counting(_bowl)
    reference = desk(run).reference(study)
    assert run.asked == [{}]
    assert (reference.figures["cycle_time"], reference.number) == (99.0, -1)


def _row(number: int, *evaluations: Evaluation) -> StudyRow:
    return StudyRow(number, (), evaluations)


def _planned(**figures: float) -> Evaluation:
    return Evaluation(
        "t",
        "planned",
        **{"cycle_time": 1.0, "gap": 0.1, "clearance": 0.02, "travel": 3.0, "torque": 0.5}
        | figures,
    )


def test_figures_of_several_jobs_become_one() -> None:
    """Times and ways add up; of gaps and torques the largest, of clearances the least."""
    row = _row(
        0, _planned(), _planned(cycle_time=2.5, gap=0.3, clearance=0.01, travel=4.0, torque=0.75)
    )
    should = {"cycle_time": 3.5, "gap": 0.3, "clearance": 0.01, "travel": 7.0, "torque": 0.75}
    assert row.figures == should


@pytest.mark.parametrize(
    ("statuses", "status"),
    [
        (["planned", "infeasible"], "infeasible"),
        (["fails_verification", "planned"], "fails_verification"),
        (["infeasible", "crashed"], "crashed"),
        (["timed_out", "bad_input"], "timed_out"),
    ],
)
def test_a_row_is_as_bad_as_its_worst_job(statuses, status) -> None:
    """And has no figures then."""
    row = _row(0, *(Evaluation("t", s, cycle_time=1.0) for s in statuses))
    assert row.status == status
    assert set(row.figures.values()) == {None}


def test_the_pareto_set_comes_first_then_all_by_the_first_objective(make_study) -> None:
    """Rounding makes nothing better; what is not known is last."""
    objectives = make_study(("cycle_time", "clearance"), a=[1]).objectives
    rows = [
        _row(0, _planned(cycle_time=5.0, clearance=0.05)),
        _row(1, _planned(cycle_time=1.0, clearance=0.01)),
        _row(2, _planned(cycle_time=1.5, clearance=0.005)),
        _row(3, _planned(cycle_time=1.0 + 1e-12, clearance=0.01)),
        _row(4, Evaluation("t", "infeasible")),
        _row(5, Evaluation("t", "planned", cycle_time=0.5)),
    ]
    ranking = rank(rows, objectives)
    assert [row.number for row in ranking.rows] == [1, 3, 0, 2, 5]
    assert ranking.pareto == {0, 1, 3}


def test_what_looks_alike_in_the_table_makes_no_row_better(make_study) -> None:
    """Proofs of one clearance differ by hundredths of a millimetre: 21.68 and 21.71 mm are both shown as 21.7."""
    objectives = make_study(("cycle_time", "clearance"), a=[1]).objectives
    rows = [
        _row(0, _planned(cycle_time=3.852, clearance=0.02171)),
        _row(1, _planned(cycle_time=3.714, clearance=0.02168)),
        _row(2, _planned(cycle_time=3.7139, clearance=0.0208)),
        _row(3, _planned(cycle_time=4.0, clearance=0.0218)),
    ]
    ranking = rank(rows, objectives)
    assert ranking.pareto == {1, 3}
    assert [row.number for row in ranking.rows] == [1, 3, 2, 0]


def test_nothing_matters_for_an_objective_that_looks_the_same_in_all_plans(
    make_study, counting, desk
) -> None:
    """20.00 and 20.03 mm; with 20.3 mm the parameter explains all."""
    for far, share in ((0.02003, None), (0.0203, 1.0)):
        study = make_study(("clearance",), a=[0, 1])
        figures = {"cycle_time": 1.0, "gap": 0.1, "travel": 1.0}
        run = counting(lambda a=0, far=far, f=figures: f | {"clearance": far if a else 0.02})
        one = desk(run)
        rows = one.rows(study, study_points(study))
        document = study_document(study, rows, one.reference(study), {"name": "grid"})
        assert document["sensitivity"][0]["parameters"][0]["share"] == pytest.approx(share)


def test_the_document_counts_failures_by_reason_and_has_no_clock(
    make_study, counting, desk
) -> None:
    """Reasons that differ in numbers only are counted together; a = 1, b = 1 is better than all others in both."""
    study = make_study(("cycle_time", "clearance"), a=[0, 1, 2, 3, 4], b=[1, 2])

    class Run(counting):
        def answer(self, request, values):
            if values and values["a"] >= 3:
                return Evaluation(
                    request.case, "infeasible", findings=(Finding(f"misses by {values['a']}.5 mm"),)
                )
            if values and values["a"] == 2:
                return Evaluation(request.case, "timed_out", findings=(Finding("took longer"),))
            return super().answer(request, values)

    own = desk(Run(_bowl))
    document = study_document(
        study, own.rows(study, study_points(study)), own.reference(study), {"name": "grid"}
    )
    assert document["counts"] == {
        "points": 10,
        "planned": 4,
        "pareto": 1,
        "infeasible": 4,
        "timed_out": 2,
    }
    assert [(f["status"], f["count"], f["points"]) for f in document["failures"]] == [
        ("infeasible", 4, [6, 7, 8, 9]),
        ("timed_out", 2, [4, 5]),
    ]
    assert document["failures"][0]["example"] == "misses by 3.5 mm"
    ranks = [row["rank"] for row in document["rows"]]
    assert ranks == [1, 2, 3, 4] + [None] * 6
    assert [row["status"] for row in document["rows"][4:]] == ["timed_out"] * 2 + ["infeasible"] * 4
    assert document["reference"]["cycle_time"] == 99.0
    assert [s["objective"] for s in document["sensitivity"]] == ["cycle_time", "clearance"]
    assert all(math.isfinite(row["cycle_time"]) for row in document["rows"][:4])
