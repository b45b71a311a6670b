"""Text of a URDF or SRDF, expanded by xacro if necessary.

Xacro runs in a confined process, because a xacro file is a program.

The process has limits on processor time, memory and output, only the environment variables of ROS, and cannot change
files or reach other programs, processes or networks (seccomp). It reads no file outside
the given folders (Landlock, Linux 5.13 and later).
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError, MissingDependencyError
from dualarm_cli.files.robots.packages import ros_folders
from dualarm_cli.files.robots.urdf_tree import parse_xml
from dualarm_cli.files.source.projects import MARKERS
from dualarm_cli.files.source.text_source import TextSource, read_text
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.system import IS_LINUX, limit_resources

_note = NoteTable(
    "program",
    confined="{path} is a program: xacro ran it confined to reading {folder}",
    free="{path} is a program: xacro ran it able to read all your files, as this kernel has no Landlock: trust "
    "its author",
)


@dataclass(frozen=True)
class ExpandedText(TextSource):
    """Text expanded by xacro; its diagnostics quote the element, because its lines differ from the file's."""

    note: Note = Note("")
    """Note on the expansion."""

    def diagnostic(self, line: int, column: int, code: str, message: str) -> Diagnostic:
        """Build a diagnostic that names the file and quotes the element."""
        rest = "\n".join([self.lines[line - 1][column - 1 :], *self.lines[line : line + 5]])
        element = re.match(r"<[^>]*>", rest)
        where = " ".join(element[0].split()) if element else self.snippet(line).strip()
        message = f"{message}; the element, as xacro expands it: {where}"
        return Diagnostic(self.name, 0, 0, code, message)


def read_expanded(path: Path) -> TextSource:
    """Read the text of a URDF or SRDF, expanded if it is a xacro file.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read, is not XML, or xacro cannot expand it with its rights.
        MissingDependencyError: it is a xacro file, and xacro is not installed.
    """
    source = read_text(path, str(path))
    if not any(child.tag.startswith("xacro:") for child in parse_xml(source).children):
        return source
    if find_spec("xacro") is None:
        raise MissingDependencyError("xacro", "xacro")
    if not IS_LINUX:
        message = (
            "is a xacro file, which only Linux expands safely; give the URDF that xacro writes"
        )
        raise InputError([Diagnostic(str(path), 0, 0, "E400", message)])
    file = Path(os.path.realpath(path))
    folders = _readable(file)
    try:
        text, confined = expanded(file, folders)
    except ConfinedError as error:
        advice = ""
        if "ermission denied" in str(error):
            advice = f"; it may read {folders[0]} and the packages of ROS_PACKAGE_PATH and AMENT_PREFIX_PATH"
        message = f"xacro cannot expand it: {error}{advice}"
        raise InputError([Diagnostic(str(path), 0, 0, "E400", message)]) from None
    note = _note("confined" if confined else "free", path=path, folder=folders[0])
    return ExpandedText(str(path), text, source.sha256, note)


def program_notes(source: TextSource) -> tuple[Note, ...]:
    """List notes on an expanded text; empty for a plain one."""
    return (source.note,) if isinstance(source, ExpandedText) else ()


def _readable(file: Path) -> list[Path]:
    """List the folders that a xacro file may read."""
    marks = ("package.xml", *MARKERS)
    root = next((f for f in file.parents if any((f / m).exists() for m in marks)), file.parent)
    ros = ros_folders(os.environ)
    # Installed packages may be links to their sources, outside the folder `install` of the workspace.
    spaces = [
        Path(str(folder).partition("/install/")[0]) for folder in ros if "/install/" in str(folder)
    ]
    return [root, *ros, *spaces]


SECONDS, BYTES, OUTPUT = 30, 4_000_000_000, 20_000_000
"""Limits of xacro: processor time [s], address space [B], result [B]."""
KEPT = ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "ROS_DISTRO", "ROS_VERSION", "LD_LIBRARY_PATH")
"""Environment variables passed to the process: paths of packages and libraries."""
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from dualarm_cli.robot_import.expanded_text import main; main(sys.argv[2], sys.argv[3:])"
)
_DENIED = {
    "execve": 59, "execveat": 322, "fork": 57, "vfork": 58, "clone": 56, "clone3": 435, "ptrace": 101, "kill": 62,
    "tkill": 200, "tgkill": 234, "rt_sigqueueinfo": 129, "rt_tgsigqueueinfo": 297, "pidfd_send_signal": 424,
    "pidfd_getfd": 438, "process_vm_readv": 310, "process_vm_writev": 311, "socket": 41, "socketpair": 53,
    "io_uring_setup": 425, "bpf": 321, "mount": 165, "unshare": 272, "setns": 308, "keyctl": 250, "prlimit64": 302,
    # Signals by fcntl's owner of a pipe, priorities, and resources shared by a user's processes.
    "fcntl": 72, "setpriority": 141, "ioprio_set": 251, "sched_setparam": 142, "sched_setscheduler": 144,
    "sched_setattr": 314, "sched_setaffinity": 203, "perf_event_open": 298, "add_key": 248, "request_key": 249,
    "shmget": 29, "shmat": 30, "shmctl": 31, "semget": 64, "semop": 65, "semctl": 66, "semtimedop": 220, "msgget": 68,
    "msgsnd": 69, "msgrcv": 70, "msgctl": 71, "mq_open": 240, "mq_unlink": 241, "memfd_create": 319,
    # Changes of files, with or without Landlock; openat2 because its flags are not in a register.
    "creat": 85, "openat2": 437, "open_by_handle_at": 304,
    "unlink": 87, "unlinkat": 263, "rename": 82, "renameat": 264, "renameat2": 316,
    "link": 86, "linkat": 265, "symlink": 88, "symlinkat": 266, "mkdir": 83, "mkdirat": 258, "rmdir": 84, "mknod": 133,
    "mknodat": 259, "chmod": 90, "fchmod": 91, "fchmodat": 268, "fchmodat2": 452, "chown": 92, "fchown": 93,
    "lchown": 94, "fchownat": 260, "utime": 132, "utimes": 235, "futimesat": 261, "utimensat": 280, "setxattr": 188,
    "lsetxattr": 189, "fsetxattr": 190, "removexattr": 197, "lremovexattr": 198, "fremovexattr": 199, "truncate": 76,
}  # fmt: skip
"""System calls that are refused, with their numbers on x86-64."""
_UNKNOWN = 463
"""First number of the refused unknown calls, of newer kernels and of x32."""
_OPEN, _OPENAT, _WRITING = 2, 257, 0o1103
"""Numbers of calls that open files, and flags refused in them."""
_LANDLOCK = {"create": 444, "add": 445, "restrict": 446}
_CAPABILITIES = 0x20080522, 0b110
"""Version of the kernel's capability sets, and capabilities kept by root: access to other users' files."""
_READ = 0b1100
"""Landlock's rights to read files and to list folders."""


class ConfinedError(Exception):
    """Error of the confined xacro process, with the reason."""


def expanded(file: Path, folders: Sequence[Path]) -> tuple[str, bool]:
    """Expand a xacro file in a separate process.

    Args:
        file: the file.
        folders: folders that it may read, besides those of Python.

    Returns:
        The expanded text, and whether reading was confined to those folders, which needs Landlock.

    Raises:
        ConfinedError: xacro, or a limit, ended it.
    """
    path = [entry for entry in sys.path if entry and Path(entry).exists()]
    command = [sys.executable, "-I", "-c", _START, json.dumps(path), str(file), *map(str, folders)]
    environment = {name: os.environ[name] for name in KEPT if name in os.environ}
    with tempfile.TemporaryFile() as result:
        try:
            ended = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=result,
                stderr=subprocess.DEVNULL,
                env=environment,
                cwd=file.parent,
                start_new_session=True,
                timeout=4 * SECONDS,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            raise ConfinedError(f"it takes longer than {4 * SECONDS} s") from None
        result.seek(0)
        data = result.read(OUTPUT)
    try:
        answer = json.loads(data)
        text, error = answer.get("text"), answer.get("error")
    except (ValueError, AttributeError, RecursionError):
        text = error = None
    if not isinstance(text, str):
        limits = f"limits are {SECONDS} s, {BYTES / 1e9:g} GB and {OUTPUT / 1e6:g} MB of text"
        raise ConfinedError(str(error) if error else f"its process ended with {ended}; {limits}")
    return text, landlock_version() > 0


def main(file: str, folders: Sequence[str]) -> None:
    """Confine this process, expand a file and print the result as JSON."""
    import xml.dom.expatbuilder  # noqa: F401  loaded now, because it may be unreadable later

    import xacro
    import yaml  # noqa: F401

    limit_resources(
        {"RLIMIT_CPU": SECONDS, "RLIMIT_AS": BYTES, "RLIMIT_FSIZE": OUTPUT, "RLIMIT_CORE": 0}
    )
    _confine([*sys.path, sys.prefix, sys.base_prefix, *folders])
    try:
        answer = {"text": xacro.process_file(file).toxml()}
    except Exception as error:  # whatever its macros raise
        answer = {"error": str(error) or type(error).__name__}
    sys.stdout.write(json.dumps(answer))


def landlock_version() -> int:
    """Return the version of Landlock in this kernel, or -1 without it."""
    return int(_libc().syscall(_LANDLOCK["create"], None, ctypes.c_size_t(0), 1))


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _confine(folders: Sequence[str]) -> None:
    """Drop this process's rights except reading given folders.

    Raises:
        OSError: the kernel refuses a restriction.
    """
    libc = _libc()
    _must(libc.prctl(38, 1, 0, 0, 0))  # PR_SET_NO_NEW_PRIVS
    rights_version, kept = _CAPABILITIES
    header, sets = (ctypes.c_uint32 * 2)(rights_version, 0), (ctypes.c_uint32 * 6)()
    _must(libc.capget(header, sets))
    # Effective, permitted and inheritable sets, then the upper words of the same.
    _must(libc.capset(header, (ctypes.c_uint32 * 6)(*(number & kept for number in sets[:3]))))
    version = landlock_version()
    if version > 0:
        # All rights of this version are handled: 13 of the first version, then moving and truncating files.
        rights = (1 << min(12 + version, 15)) - 1
        ruleset = _must(
            libc.syscall(
                _LANDLOCK["create"], ctypes.byref(ctypes.c_uint64(rights)), ctypes.c_size_t(8), 0
            )
        )
        for folder in dict.fromkeys(folders):
            if not Path(folder).is_dir():
                continue
            handle = os.open(folder, os.O_PATH | os.O_CLOEXEC)
            rule = _READ.to_bytes(8, "little") + handle.to_bytes(4, "little")
            _must(libc.syscall(_LANDLOCK["add"], ruleset, 1, rule, 0))
            os.close(handle)
        _must(libc.syscall(_LANDLOCK["restrict"], ruleset, 0))
    filters = _filters()
    program = ctypes.create_string_buffer(filters, len(filters))
    _must(
        libc.prctl(
            22, 2, ctypes.byref(_Program(len(filters) // 8, ctypes.addressof(program))), 0, 0
        )
    )


class _Program(ctypes.Structure):
    """Classic BPF program: its length in instructions, and its address."""

    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_void_p))


def _filters() -> bytes:
    """Build the seccomp program that refuses _DENIED, unknown calls and opening files to write."""

    def step(code: int, value: int, then: int = 0, otherwise: int = 0) -> bytes:
        row = (code | then << 16 | otherwise << 24, value)
        return b"".join(part.to_bytes(4, "little") for part in row)

    load, equal, above, has, jump, end = 0x20, 0x15, 0x35, 0x45, 0x05, 0x06
    refuse, allow, kill = 0x00050001, 0x7FFF0000, 0x80000000
    count = len(_DENIED)
    steps = [step(load, 4), step(equal, 0xC000003E, 1), step(end, kill), step(load, 0)]
    steps.append(step(above, _UNKNOWN, count + 8))
    steps += [step(equal, number, count + 7 - k) for k, number in enumerate(_DENIED.values())]
    steps += [step(equal, _OPEN, 2), step(equal, _OPENAT, 3), step(end, allow)]
    # The flags are open's second argument and openat's third.
    steps += [step(load, 24), step(jump, 1), step(load, 32), step(has, _WRITING, 1)]
    return b"".join([*steps, step(end, allow), step(end, refuse)])


def _must(result: int) -> int:
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result
