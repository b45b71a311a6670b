"""The store: an answer is found again only where nothing has changed, and a damaged one never."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
import zlib
from dataclasses import replace
from pathlib import Path

import pytest

from dualarm_cli.evaluation import fingerprint
from dualarm_cli.evaluation.fingerprint import hashes_now
from dualarm_cli.evaluation.store import MOST_BYTES, Store
from dualarm_cli.model.studies.evaluation import Evaluation, Finding
from dualarm_cli.page.packed import packed_document

NAMES = (
    "../../robots/planar/bottin_planar.urdf",
    "../../robots/planar/robot.yaml",
    "bundled:sda10f/robot.yaml",
    "cell.yaml",
    "tasks.yaml",
)


@pytest.fixture
def asked(cells, request_for):
    """A request, and an answer to it that was not planned: the store does not care."""
    request = request_for(cells(1)[0])
    inputs = hashes_now(NAMES, request.folder, {})
    answer = Evaluation(
        request.case,
        "planned",
        cycle_time=0.1 + 0.2,
        limiting={"b": 1.0, "a": 2.0},
        caveats=("x",),
        inputs=inputs,
    )
    return request, answer


def test_an_answer_is_found_again_as_it_was(asked, tmp_path):
    """By another process, to the last digit."""
    request, answer = asked
    Store(tmp_path / "c").keep(request, answer)
    assert Store(tmp_path / "c").find(request) == answer
    assert Store(tmp_path / "other").find(request) is None


@pytest.mark.parametrize(
    "name", ["tasks.yaml", "cell.yaml", "../../robots/planar/bottin_planar.urdf"]
)
def test_a_file_that_changed_is_noticed_and_one_that_changed_back_as_well(asked, tmp_path, name):
    """Whatever its time stamp says; a file that is gone is a change too."""
    request, answer = asked
    Store(tmp_path / "c").keep(request, answer)
    path = Path("cells/000") / name
    data, status = path.read_bytes(), path.stat()
    path.write_bytes(data.replace(b"a", b"b", 1))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert Store(tmp_path / "c").find(request) is None
    path.unlink()
    assert Store(tmp_path / "c").find(request) is None
    path.write_bytes(data)
    assert Store(tmp_path / "c").find(request) == answer


def test_two_versions_of_a_file_have_an_answer_each(asked, tmp_path):
    """As when branches are changed to and fro."""
    request, answer = asked
    store = Store(tmp_path / "c")
    store.keep(request, answer)
    path = Path("cells/000/cell.yaml")
    data = path.read_bytes()
    path.write_bytes(data + b"# other\n")
    inputs = hashes_now(NAMES, request.folder, {})
    other = replace(answer, cycle_time=7.0, inputs=inputs)
    store.keep(request, other)
    assert Store(tmp_path / "c").find(request) == other
    path.write_bytes(data)
    assert Store(tmp_path / "c").find(request) == answer


@pytest.mark.parametrize(
    "change",
    [
        {"effort": "normal"},
        {"seed": 1},
        {"platform": None},
        {"timing": "toppra"},
        {"redundancy": "numeric"},
        {"overrides": {"cell:/clearance": 0.01}},
    ],
)
def test_another_question_has_another_answer(asked, tmp_path, change):
    """Every setting decides."""
    request, answer = asked
    Store(tmp_path / "c").keep(request, answer)
    assert Store(tmp_path / "c").find(replace(request, **change)) is None


@pytest.mark.parametrize("name", ["dualarm", "sources", "numpy", "pin"])
def test_another_program_has_another_answer(asked, tmp_path, monkeypatch, name):
    """Versions of this package, its sources and its libraries."""
    request, answer = asked
    Store(tmp_path / "c").keep(request, answer)
    other = dict(fingerprint.programs()) | {name: "other"}
    monkeypatch.setattr(fingerprint, "programs", lambda: other)
    assert Store(tmp_path / "c").find(request) is None


def test_another_compiled_library_is_another_program(tmp_path, monkeypatch):
    """Another compiler changes last digits, and with them plans, though no module changes."""
    monkeypatch.setattr(fingerprint, "__file__", str(tmp_path / "evaluation" / "fingerprint.py"))
    library = tmp_path / "compiled" / "built" / "libdualarm.so"
    library.parent.mkdir(parents=True)
    library.write_bytes(b"by one compiler")
    before = fingerprint._sources()
    library.write_bytes(b"by another one")
    assert fingerprint._sources() != before


def test_a_project_folder_that_changes_is_another_question(asked, tmp_path):
    """What paths may lead to depends on it."""
    request, answer = asked
    Store(tmp_path / "c").keep(request, answer)
    fingerprint._project.cache_clear()
    Path("cells/dualarm.toml").touch()
    try:
        assert Store(tmp_path / "c").find(request) is None
    finally:
        fingerprint._project.cache_clear()


@pytest.mark.parametrize("status", ["bad_input", "internal_error", "timed_out", "crashed"])
def test_what_may_come_out_otherwise_is_not_kept(asked, tmp_path, status):
    """Only what the same input always comes to."""
    request, answer = asked
    Store(tmp_path / "c").keep(request, replace(answer, status=status))
    assert not (tmp_path / "c").exists()


def test_infeasible_ones_are_kept_with_their_findings(asked, tmp_path):
    """Proving that there is no plan takes as long as finding one."""
    request, answer = asked
    failed = replace(
        answer, status="infeasible", cycle_time=None, findings=(Finding("too far", "a", 1, 2),)
    )
    Store(tmp_path / "c").keep(request, failed)
    assert Store(tmp_path / "c").find(request) == failed


def test_a_file_that_changed_while_it_was_planned_is_not_kept(asked, tmp_path):
    """The answer is of what the file held before."""
    request, answer = asked
    Path("cells/000/cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    Store(tmp_path / "c").keep(request, answer)
    assert not (tmp_path / "c").exists()


def test_no_damage_of_an_entry_is_taken_for_an_answer(asked, tmp_path):
    """Cut off at any place, any byte changed, nested without end: as if it were not there, and repaired."""
    request, answer = asked
    store = Store(tmp_path / "c")
    store.keep(request, answer)
    entries = sorted((tmp_path / "c").rglob("*/*.json"))
    assert len(entries) == 2
    for entry in entries:
        whole = entry.read_bytes()
        for k in range(0, len(whole), 7):
            for damaged in (whole[:k], whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :]):
                entry.write_bytes(damaged)
                found = Store(tmp_path / "c").find(request)
                assert found is None
        entry.write_bytes(b"[" * 100_000)
        assert Store(tmp_path / "c").find(request) is None
        store.keep(request, answer)
        assert entry.read_bytes() == whole


def test_an_entry_of_another_key_is_not_believed(asked, tmp_path):
    """Files of the store that somebody has swapped."""
    request, answer = asked
    store = Store(tmp_path / "c")
    store.keep(request, answer)
    other = replace(request, seed=1)
    store.keep(other, replace(answer, cycle_time=9.0))
    one, two = sorted((tmp_path / "c" / "answers").rglob("*.json"))
    one_bytes, two_bytes = one.read_bytes(), two.read_bytes()
    one.write_bytes(two_bytes)
    two.write_bytes(one_bytes)
    assert Store(tmp_path / "c").find(request) is None
    assert Store(tmp_path / "c").find(other) is None


def test_entries_may_be_read_by_whom_other_new_files_may(asked, tmp_path):
    """A cache in a shared folder serves all who share it."""
    request, answer = asked
    former = os.umask(0o027)
    try:
        Store(tmp_path / "c").keep(request, answer)
    finally:
        os.umask(former)
    entries = [path for path in (tmp_path / "c").rglob("*") if path.is_file()]
    assert len(entries) == 3
    assert {path.stat().st_mode & 0o777 for path in entries} == {0o640}


def test_a_store_that_cannot_be_written_says_so_and_raises_nothing(asked, tmp_path):
    """Its folder is a file."""
    request, answer = asked
    (tmp_path / "c").write_text("mine")
    store = Store(tmp_path / "c")
    store.keep(request, answer)
    assert store.problem
    assert store.find(request) is None
    assert (tmp_path / "c").read_text() == "mine"


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1e400", "1" + "0" * 5000])
def test_a_number_beyond_floats_is_no_answer(asked, tmp_path, number):
    """In each figure, with a checksum that is right where the number can be read."""
    request, answer = asked
    store = Store(tmp_path / "c")
    store.keep(request, answer)
    [entry] = (tmp_path / "c" / "answers").rglob("*.json")
    document = json.loads(entry.read_text())
    text = json.dumps(document["content"] | {"travel": 7.25}, sort_keys=True, separators=(",", ":"))
    text = text.replace("7.25", number)
    held = document | {"sha256": hashlib.sha256(text.encode()).hexdigest(), "content": "CONTENT"}
    entry.write_text(json.dumps(held).replace('"CONTENT"', text))
    assert store.find(request) is None


def test_a_page_that_unpacks_without_end_is_not_unpacked(asked, tmp_path):
    """Fifty megabytes and a byte, packed to a fiftieth of one; also no base64, no JSON, no object, and NaN."""
    request, answer = asked
    request, store = replace(request, page=True), Store(tmp_path / "c")
    good = packed_document({"a": 1})
    store.keep(request, replace(answer, page=good))
    assert store.find(request).page == good
    long = base64.b64encode(zlib.compress(b'{"a": ' + b" " * MOST_BYTES + b"1}")).decode()
    others = [
        base64.b64encode(zlib.compress(text)).decode() for text in (b"[1]", b"{", b'{"a":NaN}')
    ]
    for page in (long, good[:-8], "?", *others):
        store.keep(request, replace(answer, page=page))
        assert store.find(request) is None


def test_links_and_pipes_in_a_store_lead_nowhere(asked, tmp_path):
    """Nothing is removed or written elsewhere, and nothing is waited for."""
    request, answer = asked
    precious = tmp_path / "elsewhere" / "precious"
    precious.parent.mkdir()
    precious.touch()
    os.utime(precious, (time.time() - 7200,) * 2)
    store = Store(tmp_path / "c")
    store.keep(request, answer)
    [entry] = (tmp_path / "c" / "answers").rglob("*.json")
    entry.unlink()
    os.mkfifo(entry)
    assert store.find(request) is None
    shutil.rmtree(entry.parent)
    entry.parent.symlink_to(precious.parent)
    (tmp_path / "c" / "making").rmdir()
    (tmp_path / "c" / "making").symlink_to(precious.parent)
    store = Store(tmp_path / "c")
    store.keep(request, answer)
    assert "leads out of the folder" in store.problem
    assert list(precious.parent.iterdir()) == [precious]


def test_what_killed_processes_left_is_removed_in_the_end(asked, tmp_path):
    """Not what another process is making now."""
    request, answer = asked
    Store(tmp_path / "c").keep(request, answer)
    old, new = (tmp_path / "c" / "making" / name for name in ("old", "new"))
    old.touch()
    new.touch()
    os.utime(old, (time.time() - 7200,) * 2)
    Store(tmp_path / "c")
    assert not old.exists()
    assert new.exists()
    assert (tmp_path / "c" / ".gitignore").read_text().endswith("*\n")


WRITER = """
import json, sys
from dataclasses import replace
from pathlib import Path
from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.model.studies.evaluation import Evaluation
request = Request.of_document(json.loads(sys.argv[1]))
answer = Evaluation.of_document(json.loads(sys.argv[2]))
store = Store(Path(sys.argv[3]))
for round in range(50):
    for seed in range(4):
        one = replace(request, seed=seed)
        store.keep(one, replace(answer, cycle_time=float(seed)))
        found = Store(Path(sys.argv[3])).find(one)
        assert found is not None and found.cycle_time == seed, (round, seed)
assert not store.problem, store.problem
"""


def test_three_processes_on_one_store_never_see_half_an_entry(asked, tmp_path):
    """All write and read the same entries again and again."""
    request, answer = asked
    words = [json.dumps(request.as_document()), json.dumps(answer.as_document())]
    command = [sys.executable, "-c", WRITER, *words, str(tmp_path / "c")]
    writers = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    for writer in writers:
        _, err = writer.communicate(timeout=60)
        assert writer.returncode == 0, err
    assert not list((tmp_path / "c" / "making").iterdir())
    assert len(list((tmp_path / "c" / "answers").rglob("*.json"))) == 4


@pytest.mark.parametrize(
    "figures",
    [
        {"lower_bound": 0.31, "gap": (0.3 - 0.31) / 0.3},
        {"lower_bound": 0.27, "gap": 0.5},
        {"lower_bound": 0.27, "gap": None},
        {"lower_bound": None, "gap": 0.1},
        {"cycle_time": None},
        {"cycle_time": -1.0},
        {"status": "infeasible"},
    ],
)
def test_an_answer_whose_figures_contradict_each_other_is_not_believed(asked, tmp_path, figures):
    """A cycle time below its own lower bound, with a checksum that is right; the same without that is found."""
    request, answer = asked
    answer = replace(answer, cycle_time=0.3, lower_bound=0.27, gap=0.1)
    Store(tmp_path / "good").keep(request, answer)
    assert Store(tmp_path / "good").find(request) == answer
    Store(tmp_path / "bad").keep(request, replace(answer, **figures))
    assert Store(tmp_path / "bad").find(request) is None
