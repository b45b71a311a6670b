"""Files whole or not at all: refused, full, read-only, killed."""

from __future__ import annotations

import errno
import hashlib
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dualarm_cli.errors import OutputError
from dualarm_cli.exporting.files import check_writable, write_schedule_set
from dualarm_cli.exporting.schedule_reader import read_schedule, torn_files
from dualarm_cli.exporting.whole_files import replace_all, write_file

OTHERS = {"report.json": [b"new"], "schedule.csv": [b"time\n", b"0\n"]}
NAMES = ["report.json", "robot.urdf", "schedule.csv", "schedule.json"]


def contents(folder):
    """Returns every file of a folder, hidden ones too."""
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.is_file()}


def test_a_set_is_written_whole_with_the_hashes_of_its_other_files(folder):
    """Four files, no trace of how they were made; readable as the user's umask says."""
    files = contents(folder)
    assert sorted(files) == NAMES
    stated = read_schedule(folder).extra["files"]
    assert stated == {
        name: hashlib.sha256(files[name]).hexdigest() for name in NAMES if name != "schedule.json"
    }


def test_files_have_the_rights_that_the_umask_leaves(schedule, tmp_path):
    """Not the 0600 of a temporary file."""
    old = os.umask(0o027)
    try:
        write_schedule_set(tmp_path, schedule, {}, False)
    finally:
        os.umask(old)
    assert {file.stat().st_mode & 0o777 for file in tmp_path.iterdir()} == {0o640}


def test_folders_are_made_as_needed(schedule, tmp_path):
    """Three levels."""
    write_schedule_set(tmp_path / "a" / "b" / "c", schedule, {}, False)
    assert (tmp_path / "a" / "b" / "c" / "schedule.json").is_file()


def test_a_schedule_is_not_replaced_unasked(folder, schedule):
    """The old files stay; with force they are replaced."""
    before = contents(folder)
    for action, force in (
        (lambda: check_writable(folder, False), "add --force"),
        (lambda: write_schedule_set(folder, schedule, OTHERS, False), "pass force=True"),
    ):
        with pytest.raises(OutputError, match=f"already holds a schedule; {force}"):
            action()
    assert contents(folder) == before
    write_schedule_set(folder, schedule, OTHERS, True)
    assert contents(folder)["report.json"] == b"new"


@pytest.mark.parametrize(
    "name", ["robot.urdf", "schedule.csv", "events.csv", "targets.csv", "report.json"]
)
def test_no_file_of_the_users_own_is_replaced_unasked(schedule, tmp_path, name):
    """`--out .` in a project that has a robot.urdf of its own."""
    (tmp_path / name).write_text("mine")
    with pytest.raises(OutputError, match=f"already holds a file {name}; pass force=True"):
        write_schedule_set(tmp_path, schedule, OTHERS, False)
    assert contents(tmp_path) == {name: b"mine"}


def test_a_file_in_the_way_is_named(schedule, tmp_path):
    """--out is a file, or lies below one."""
    (tmp_path / "out").write_text("mine")
    with pytest.raises(OutputError, match="is a file; name a folder"):
        write_schedule_set(tmp_path / "out", schedule, {}, True)
    with pytest.raises(OutputError, match="out is a file, not a folder"):
        write_schedule_set(tmp_path / "out" / "deeper", schedule, {}, True)
    assert contents(tmp_path) == {"out": b"mine"}


def test_a_read_only_place_is_refused_before_any_work(tmp_path, monkeypatch):
    """The tests may run as root, who may write everywhere: the system's answer is simulated."""
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    with pytest.raises(OutputError, match=f"no permission to write in {tmp_path}"):
        check_writable(tmp_path / "new", False)


def test_a_folder_that_cannot_be_made_is_named(schedule, tmp_path):
    """A link to nowhere stands where the folder should be."""
    (tmp_path / "out").symlink_to(tmp_path / "nowhere" / "at" / "all")
    with pytest.raises(OutputError, match="cannot be made: "):
        write_schedule_set(tmp_path / "out", schedule, {}, False)


@pytest.mark.parametrize("call", [1, 2, 3, 4])
def test_a_full_disk_leaves_the_old_files_untouched_and_no_rubbish(
    folder, schedule, monkeypatch, call
):
    """ENOSPC on the way to the disk, at each of the four files."""
    before, calls, real = contents(folder), [], os.fsync

    def full(handle):
        calls.append(handle)
        if len(calls) == call:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="cannot be written: No space left on device"):
        write_schedule_set(folder, schedule, OTHERS, True)
    assert contents(folder) == before


def test_a_full_disk_while_writing_leaves_the_old_files_untouched(folder, schedule, monkeypatch):
    """ENOSPC out of the file itself, amid its content."""
    before, real = contents(folder), os.fdopen

    def opened(handle, mode):
        file = real(handle, mode, buffering=0)
        write = file.write

        class Full:
            """A file that takes the first ten bytes."""

            def __enter__(self):
                return self

            def __exit__(self, *_):
                file.close()

            def writelines(self, parts):
                write(next(iter(parts))[:10])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        return Full()

    monkeypatch.setattr(os, "fdopen", opened)
    with pytest.raises(OutputError, match="No space left on device"):
        write_schedule_set(folder, schedule, OTHERS, True)
    assert contents(folder) == before


def test_an_interrupt_leaves_the_old_files_untouched_and_no_rubbish(folder, schedule, monkeypatch):
    """Ctrl-C while the third file is on its way."""
    before, calls = contents(folder), []

    def interrupted(handle):
        calls.append(handle)
        if len(calls) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_schedule_set(folder, schedule, OTHERS, True)
    assert contents(folder) == before


def test_a_mesh_of_an_earlier_cell_is_refused_before_planning(tmp_path):
    """The option is named, as for every file of a plan."""
    (tmp_path / "mesh_table_0.stl").write_bytes(b"solid\n")
    with pytest.raises(OutputError, match=r"^--out .*a file mesh_table_0\.stl; add --force"):
        check_writable(tmp_path, False)
    check_writable(tmp_path, True)


def test_a_folder_where_a_file_should_be_leaves_the_old_schedule_in_force(folder, schedule):
    """schedule.csv is a folder: schedule.json, which goes last, stays the old one; no rubbish."""
    (folder / "schedule.csv").unlink()
    (folder / "schedule.csv").mkdir()
    before = contents(folder)
    with pytest.raises(OutputError, match="cannot be written: Is a directory"):
        write_schedule_set(folder, schedule, OTHERS, True)
    after = contents(folder)
    assert after["schedule.json"] == before["schedule.json"]
    assert sorted(after) == sorted(before)


CHILD = """
import sys
from dataclasses import replace
from pathlib import Path
from dualarm_cli.exporting.files import write_schedule_set
from dualarm_cli.exporting.schedule_reader import read_schedule
folder = Path(sys.argv[1])
schedule = read_schedule(folder)
while True:
    for word in (b"a", b"b"):
        other = replace(schedule, notes=(word.decode(),))
        other = replace(other, robot=replace(other.robot, urdf=f"{schedule.robot.urdf}<!--{word.decode()}-->"))
        write_schedule_set(folder, other, {"report.json": [word * 2_000_000], "schedule.csv": [b"time"]}, True)
        print("written", flush=True)
"""


def test_a_writer_that_is_killed_leaves_every_file_whole(folder):
    """SIGKILL at random moments: each file is one version or the other, a mixed set is noticed."""
    rng = random.Random(5)
    for _ in range(6):
        child = subprocess.Popen([sys.executable, "-c", CHILD, str(folder)], stdout=subprocess.PIPE)
        for _ in range(2):
            assert child.stdout.readline() == b"written\n"
        time.sleep(rng.uniform(0, 0.03))
        child.kill()
        child.communicate()
        schedule = read_schedule(folder)
        versions = {
            "schedule.json": schedule.notes[0],
            "robot.urdf": (folder / "robot.urdf").read_text()[-4],
        }
        report = (folder / "report.json").read_bytes()
        assert report in (b"a" * 2_000_000, b"b" * 2_000_000)
        versions["report.json"] = report[:1].decode()
        assert set(versions.values()) <= {"a", "b"}
        # The table is the same in both versions; the other two carry their own.
        mixed = [
            n for n in ("report.json", "robot.urdf") if versions[n] != versions["schedule.json"]
        ]
        assert torn_files(folder, schedule) == [f"{name} was changed" for name in mixed]
        # read_schedule of the next child needs the URDF as it was.
        urdf = folder / "robot.urdf"
        urdf.write_text(urdf.read_text().split("<!--")[0])


def test_one_file_is_written_whole_and_not_over_another(tmp_path):
    """As the commands with a single result do."""
    file = tmp_path / "result.json"
    write_file(file, b"one", False)
    with pytest.raises(OutputError, match="already exists; add --force"):
        write_file(file, b"two", False)
    assert file.read_bytes() == b"one"
    write_file(file, b"two", True)
    assert contents(tmp_path) == {"result.json": b"two"}
    with pytest.raises(OutputError, match="is a folder; name a file"):
        write_file(tmp_path, b"x", True)
    with pytest.raises(OutputError, match="there is no folder"):
        write_file(tmp_path / "no" / "x", b"x", False)


def test_a_device_or_a_pipe_is_not_replaced(tmp_path):
    """`--junit /dev/null` as root would take it from the whole machine; a named pipe stands for one here."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OutputError, match="is not a regular file"):
        write_file(pipe, b"x", True)
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


def test_a_link_stays_a_link_and_a_file_keeps_its_permissions(tmp_path):
    """A baseline may be a link into another folder, and private."""
    (tmp_path / "shared").mkdir()
    target, link = tmp_path / "shared" / "baseline.json", tmp_path / "baseline.json"
    target.write_bytes(b"old")
    target.chmod(0o600)
    link.symlink_to(Path("shared") / "baseline.json")
    write_file(link, b"new", True)
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert target.stat().st_mode & 0o777 == 0o600
    assert sorted(p.name for p in tmp_path.rglob("*")) == [
        "baseline.json",
        "baseline.json",
        "shared",
    ]
    ahead = tmp_path / "ahead.json"
    ahead.symlink_to(Path("shared") / "new.json")
    write_file(ahead, b"first", False)
    assert ahead.is_symlink()
    assert (tmp_path / "shared" / "new.json").read_bytes() == b"first"


def test_no_file_of_a_folder_leads_out_of_it(tmp_path, schedule, folder):
    """By a link to a file that is there or is not, by one to a folder, by the name; links within it are followed."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "there").write_text("mine")
    links = {"there": outside / "there", "not": outside / "new", "down": outside}
    for name, target in links.items():
        (folder / name).symlink_to(target)
    for name in ("there", "not", "down/new", "../outside/new"):
        with pytest.raises(OutputError, match=f"{name} leads out of the folder"):
            replace_all(folder, {"first": [b"x"], name: [b"x"]})
        assert not (folder / "first").exists()
    assert contents(outside) == {"there": b"mine"}
    (folder / "within").symlink_to("first")
    replace_all(folder, {"within": [b"x"], "deep/er": [b"y"]})
    assert (folder / "first").read_bytes() == b"x"
    assert (folder / "within").is_symlink()
    (folder / "schedule.csv").unlink()
    (folder / "schedule.csv").symlink_to(outside / "new")
    with pytest.raises(OutputError, match=r"schedule\.csv leads out"):
        write_schedule_set(folder, schedule, OTHERS, True)
    assert contents(outside) == {"there": b"mine"}


def test_a_pipe_that_looks_like_a_file_in_the_making_is_left_alone(tmp_path):
    pipe = tmp_path / ".file.x.part"
    os.mkfifo(pipe)
    replace_all(tmp_path, {"file": [b"x"]})
    assert pipe.is_fifo()


HALF = """
import sys, time
from pathlib import Path
from dualarm_cli.exporting.whole_files import replace_all

def parts():
    yield b"half"
    print("writing", flush=True)
    time.sleep(60)

replace_all(Path(sys.argv[1]), {"schedule.json": parts()})
"""


def test_what_a_killed_writer_left_goes_with_the_next_one_and_what_is_being_written_stays(tmp_path):
    """Two processes write; one is killed; a third writer removes only what that one left."""
    children = [
        subprocess.Popen([sys.executable, "-c", HALF, str(tmp_path)], stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    try:
        for child in children:
            assert child.stdout.readline() == b"writing\n"
        (tmp_path / ".other.abc.part").write_bytes(b"somebody's")
        children[0].kill()
        children[0].wait()
        long_ago = time.time() - 10.0
        for path in tmp_path.iterdir():
            os.utime(path, (long_ago, long_ago))
        assert len(list(tmp_path.glob(".schedule.json.*.part"))) == 2
        replace_all(tmp_path, {"schedule.json": [b"whole"]})
        assert len(list(tmp_path.glob(".schedule.json.*.part"))) == 1
        assert (tmp_path / "schedule.json").read_bytes() == b"whole"
        assert (tmp_path / ".other.abc.part").exists()
    finally:
        for child in children:
            child.kill()
            child.communicate()
