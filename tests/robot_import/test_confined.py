"""Xacro files are programs: they run without rights beyond their folder, and it is said that they are programs."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.errors import InputError
from dualarm_cli.robot_import import confined, expanded_text
from dualarm_cli.robot_import.confined import (
    ConfinedError,
    XacroRequest,
    expanded,
    landlock_version,
)
from dualarm_cli.robot_import.expanded_text import program_notes, read_expanded

ROOT = '<robot name="odd" xmlns:xacro="http://www.ros.org/wiki/xacro">'
LANDLOCK = pytest.mark.skipif(landlock_version() < 1, reason="this kernel has no Landlock")


def program(code: str) -> str:
    """Returns a xacro file that runs Python code, past what xacro keeps expressions from; it ends with an error."""
    text = "'" + "".join(f"\\x{ord(c):02x}" for c in code) + "'"
    hidden = r"'\x5f\x5fbuiltins\x5f\x5f'"
    builtins = "G[0].gi_frame.f_back.f_back.f_back.f_back.f_back.f_builtins"
    call = f"{builtins}['exec']({text}, dict([({hidden}, {builtins})]))"
    body = f"(lambda G: [G.append(({call} for _ in [1])), [x for x in G[0]]])([])"
    return f'{ROOT}<xacro:property name="p" value="${{ {body} }}"/><link name="a${{p}}"/></robot>'


def system_call(number: int, *arguments: str) -> str:
    """Returns code that makes a system call by its number, and raises OSError where it is refused."""
    return library_call("syscall", str(number), *arguments)


def library_call(name: str, *arguments: str) -> str:
    """Returns code that calls a function of the C library, and raises OSError where it fails."""
    library = "__import__('ctypes').CDLL(None, use_errno=True)"
    raised = "(_ for _ in ()).throw(OSError(__import__('ctypes').get_errno(), 'refused'))"
    return f"{library}.{name}({', '.join(arguments)}) + 1 or {raised}"


def told(tmp_path: Path, attempts: dict[str, str]) -> dict[str, str]:
    """Returns what came of attempts in a xacro file: the name of the error, or `done`."""
    lines = ["found = []"]
    for name, code in attempts.items():
        lines += [
            "try:",
            f"    {code}",
            f"    found.append({name!r} + ' done')",
            "except BaseException as error:",
        ]
        lines.append(f"    found.append({name!r} + ' ' + type(error).__name__)")
    lines.append("raise Exception('TOLD:' + ','.join(found) + ':')")
    path = tmp_path / "home" / "robot.urdf.xacro"
    path.parent.mkdir()
    path.write_text(program("\n".join(lines)))
    with pytest.raises(ConfinedError) as refused:
        expanded(XacroRequest(path, path.parent))
    return dict(
        part.split(" ", 1) for part in str(refused.value).split("TOLD:")[1].split(":")[0].split(",")
    )


def test_a_xacro_file_reaches_no_program_no_process_and_no_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Code that breaks out of xacro's expressions finds nothing to do, and no secret in its environment."""
    monkeypatch.setenv("TOKEN", "secret")
    attempts = {
        "fork": "__import__('os').fork()",
        "exec": "__import__('os').execv('/bin/sh', ['sh'])",
        "spawn": "__import__('os').posix_spawn('/bin/sh', ['sh'], {})",
        "socket": "__import__('socket').socket()",
        "kill": "__import__('os').kill(__import__('os').getppid(), 0)",
        "signal": system_call(129, "__import__('os').getppid()", "0", "bytes(128)"),
        "look": system_call(310, "__import__('os').getppid()", "None", "0", "None", "0", "0"),
        "memory": "len(bytes(10**10))",
        "memory-file": "__import__('os').memfd_create('a')",
        "limit": system_call(160, "9", "bytes([255]) * 16"),
        "root": "__import__('os').chroot('/')",
        "signal-of-a-pipe": "__import__('fcntl').fcntl(__import__('os').pipe()[0], 8, __import__('os').getppid())",
        "priority": "__import__('os').setpriority(0, 0, __import__('os').getpriority(0, 0))",
        "processors": "__import__('os').sched_setaffinity(0, __import__('os').sched_getaffinity(0))",
        "shared-memory": system_call(29, "0x1234", "0", "0"),
        "messages": system_call(68, "0x1234", "0"),
        "queue": system_call(240, "b'none'", "0", "0", "None"),
        "key": system_call(249, "b'user'", "b'none'", "None", "0"),
    }
    found = told(tmp_path, attempts | {"token": "__import__('os').environ['TOKEN']"})
    assert found.pop("token") == "KeyError"
    assert found.pop("memory") == "MemoryError"
    assert set(found.values()) == {"PermissionError"}


@pytest.mark.parametrize("landlock", [pytest.param(True, marks=LANDLOCK), False])
def test_a_xacro_file_reads_its_folder_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, landlock: bool
) -> None:
    """Beside it, above it and elsewhere; without Landlock it reads what the user can, and changes as little."""
    if not landlock:
        off = (
            "import dualarm_cli.robot_import.confined as c; c.landlock_version = lambda: -1; main("
        )
        monkeypatch.setattr(confined, "_START", confined._START.replace("main(", off))
    secret = tmp_path / "secret"
    secret.write_text("mine")
    home = tmp_path / "home"
    attempts = {
        "own": f"open('{home}/robot.urdf.xacro').read()",
        "above": f"open('{secret}').read()",
        "system": "open('/etc/passwd').read()",
        "process": "open('/proc/self/environ').read()",
        "list": f"__import__('os').listdir('{tmp_path}')",
        "write": f"open('{home}/new', 'w')",
        "append": f"open('{secret}', 'a')",
        "cut": f"__import__('os').truncate('{secret}', 0)",
        "cut-by-opening": f"__import__('os').open('{secret}', __import__('os').O_TRUNC)",
        "both": f"open('{secret}', 'r+')",
        "old-open": system_call(2, f"b'{home}/new'", "0o102", "0o600"),
        "old-create": system_call(85, f"b'{home}/new'", "0o600"),
        "folder": f"__import__('os').mkdir('{home}/folder')",
        "pipe": f"__import__('os').mkfifo('{home}/pipe')",
        "second-name": f"__import__('os').link('{secret}', '{home}/link')",
        "remove": f"__import__('os').remove('{home}/robot.urdf.xacro')",
        "link": f"__import__('os').symlink('{secret}', '{home}/link')",
        "move": f"__import__('os').rename('{home}/robot.urdf.xacro', '{home}/x')",
        "rights": f"__import__('os').chmod('{secret}', 0o777)",
        "time": f"__import__('os').utime('{secret}', (0, 0))",
        "mark": f"__import__('os').setxattr('{secret}', 'user.mark', b'1')",
        "mark-at": system_call(463, "-100", f"b'{secret}'", "0", "b'user.mark'", "None", "0"),
        "handle": system_call(304, "-100", "bytes(64)", "1"),
        "unknown": system_call(1000),
    }
    before = secret.stat()
    assert len(attempts) == 24
    found = told(tmp_path, attempts)
    assert found.pop("own") == "done"
    reading = {found.pop(name) for name in ("above", "system", "process", "list")}
    assert reading == {"PermissionError" if landlock else "done"}
    assert set(found.values()) == {"PermissionError"}
    assert secret.read_text() == "mine"
    assert (secret.stat().st_mode, secret.stat().st_mtime) == (before.st_mode, before.st_mtime)
    assert [path.name for path in home.iterdir()] == ["robot.urdf.xacro"]


PATH = "unlink rmdir mkdir mknod chmod chown lchown truncate creat utime utimes setxattr lsetxattr removexattr"
AT = "unlinkat mkdirat mknodat fchmodat fchownat futimesat utimensat"


def test_no_function_of_the_library_changes_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Called by name, in a folder that is not there: it is refused, not sought; without Landlock."""
    off = "import dualarm_cli.robot_import.confined as c; c.landlock_version = lambda: -1; main("
    monkeypatch.setattr(confined, "_START", confined._START.replace("main(", off))
    path, rest = "b'none/a'", ("0", "0", "0", "0")
    attempts = {name: library_call(name, path, *rest) for name in PATH.split()}
    attempts |= {name: library_call(name, "-100", path, *rest) for name in AT.split()}
    attempts |= {
        name: library_call(name, path, path, "0", "0")
        for name in ("rename", "link", "symlink", "lremovexattr")
    }
    attempts |= {
        name: library_call(name, "-100", path, "-100", path, "0")
        for name in ("renameat", "renameat2", "linkat")
    }
    attempts["symlinkat"] = library_call("symlinkat", path, "-100", path)
    attempts |= {
        name: library_call(name, "-1", path, "0", "0")
        for name in ("fchmod", "fchown", "fsetxattr", "fremovexattr")
    }
    allowed = library_call("access", path, "0")
    found = told(tmp_path, attempts | {"access": allowed})
    assert found.pop("access") == "FileNotFoundError"
    assert {name for name, error in found.items() if error != "PermissionError"} == set()


@LANDLOCK
def test_what_a_package_includes_is_read_and_what_is_outside_is_named(tmp_path: Path) -> None:
    """From `urdf` in a package to its other folders; the advice says what may be read."""
    package = tmp_path / "arm"
    for folder in ("urdf", "parts"):
        (package / folder).mkdir(parents=True)
    (package / "package.xml").write_text("<package/>")
    for path in (package / "parts" / "link.xacro", tmp_path / "outside.xacro"):
        path.write_text(f'{ROOT}<link name="included"/></robot>')
    file = package / "urdf" / "arm.urdf.xacro"
    file.write_text(f'{ROOT}<xacro:include filename="../parts/link.xacro"/></robot>')
    source = read_expanded(file)
    assert '<link name="included"/>' in source.text
    assert program_notes(source) == (
        f"{file} is a program: xacro ran it confined to reading {package}",
    )
    file.write_text(f'{ROOT}<xacro:include filename="../../outside.xacro"/></robot>')
    with pytest.raises(
        InputError, match=f"Permission denied.*it may read {package} and ROS packages"
    ):
        read_expanded(file)


def test_without_landlock_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "arm.urdf.xacro"
    file.write_text(f'{ROOT}<xacro:property name="a" value="1"/></robot>')
    monkeypatch.setattr(expanded_text, "landlock_version", lambda: -1)
    [note] = program_notes(read_expanded(file))
    assert "is a program: xacro ran it able to read all your files" in note


def test_a_program_that_ends_its_process_or_does_not_end_is_no_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "arm.urdf.xacro"
    file.write_text(program("__import__('os')._exit(7)"))
    with pytest.raises(
        InputError, match="E400 xacro cannot expand it: its process ended with 7; limits"
    ):
        read_expanded(file)
    monkeypatch.setattr(confined, "SECONDS", 0.5)
    file.write_text(program("while True: pass"))
    with pytest.raises(InputError, match=r"it takes longer than 2\.0 s"):
        read_expanded(file)


def test_the_command_says_that_the_file_is_a_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By `robot import`; and no file at all is expanded by a module of xacro in the folder."""
    monkeypatch.chdir(tmp_path)
    Path("xacro.py").write_text("raise SystemExit(9)")
    axes = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    rows = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0 0 0.2"/>'
        f'<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="2" effort="1"/></joint><link name="l{k + 1}"/>'
        for k, axis in enumerate(axes)
    )
    Path("arm.xacro").write_text(
        f'{ROOT}<xacro:property name="a" value="1"/><link name="l0"/>{rows}</robot>'
    )
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    assert run(["robot", "import", "arm.xacro", "--left-tip", "l6", "--right-tip", "none"]) == 0
    assert "arm.xacro is a program: xacro ran it" in capsys.readouterr().err
