"""Confined process for xacro, because a xacro file is a program.

The process has limits on processor time, memory and output, only the environment variables of ROS, and cannot change
files or reach other programs, processes or networks (seccomp). It reads no file outside
the given folders (Landlock, Linux 5.13 and later).
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

from dualarm_cli.files.robots.packages import ros_folders
from dualarm_cli.files.robots.urdf import MOVING_TYPES
from dualarm_cli.records import dataclass
from dualarm_cli.system import limit_resources

SECONDS, BYTES, OUTPUT = 30, 4_000_000_000, 20_000_000
"""Limits of xacro: processor time [s], address space [B], result [B]."""
KEPT = ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "ROS_DISTRO", "ROS_VERSION", "LD_LIBRARY_PATH")
"""Environment variables passed to the process: paths of packages and libraries."""
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from dualarm_cli.robot_import.confined import main; main(sys.argv[2], sys.argv[3:])"
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
"""Version of kernel capability sets, and capabilities kept by root.

They give access to other users' files.
"""
_READ = 0b1100
"""Landlock's rights to read files and to list folders."""


@dataclass(frozen=True)
class XacroInput:
    """Input of xacro files besides their text."""

    arguments: Mapping[str, str] = field(default_factory=dict)
    """Values of arguments by name, from `--xacro-arg`."""
    packages: tuple[Path, ...] = ()
    """Folders of ROS packages, from `--package-dir`."""


@dataclass(frozen=True)
class Expansion:
    """Result of xacro."""

    text: str
    """Expanded text."""
    defaults: Mapping[str, str]
    """Arguments at their default values, by name."""
    arguments: frozenset[str]
    """Names of all arguments."""
    packages: Mapping[str, Path]
    """Folders of the packages that the file includes from, by name."""
    joints: tuple[int, ...] = ()
    """Number of moving joints with each set of other arguments.

    0 if it cannot be expanded.
    """


@dataclass(frozen=True)
class XacroRequest:
    """Request to expand a xacro file in a confined process."""

    file: Path
    """Resolved path of the file."""
    root: Path
    """Folder that it may always read."""
    given: XacroInput = XacroInput()
    """Arguments and packages given by the user."""
    packages: Mapping[str, Path] = field(default_factory=dict)
    """Folders of packages for `$(find …)`, by name."""
    trials: Sequence[Mapping[str, str]] = ()
    """Other sets of arguments whose moving joints are counted."""

    @property
    def folders(self) -> list[Path]:
        """Folders that the process may read, besides those of Python."""
        named = [*ros_folders(os.environ), *(f.absolute() for f in self.given.packages)]
        # Installed packages may be links to their sources, outside the folder `install` of the workspace.
        spaces = [Path(str(f).partition("/install/")[0]) for f in named if "/install/" in f"{f}/"]
        return [self.root, *self.packages.values(), *named, *spaces]


class ConfinedError(Exception):
    """Error of the confined xacro process, with the reason."""

    def __init__(
        self, reason: str, package: str = "", defaults: Mapping[str, str] | None = None
    ) -> None:
        """Store the package that the file needs, and arguments at their defaults so far."""
        self.package, self.defaults = package, defaults or {}
        super().__init__(reason)


def expanded(request: XacroRequest) -> Expansion:
    """Expand a xacro file in a separate process.

    Raises:
        ConfinedError: xacro, or a limit, ended it.
    """
    path = [entry for entry in sys.path if entry and Path(entry).exists()]
    work = {
        "file": str(request.file),
        "sets": [dict(request.given.arguments), *map(dict, request.trials)],
        "packages": {name: str(folder) for name, folder in request.packages.items()},
    }
    folders = map(str, request.folders)
    command = [sys.executable, "-I", "-c", _START, json.dumps(path), json.dumps(work), *folders]
    environment = {name: os.environ[name] for name in KEPT if name in os.environ}
    with tempfile.TemporaryFile() as result:
        try:
            ended = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=result,
                stderr=subprocess.DEVNULL,
                env=environment,
                cwd=request.file.parent,
                start_new_session=True,
                timeout=4 * SECONDS,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            raise ConfinedError(f"it takes longer than {4 * SECONDS} s") from None
        result.seek(0)
        data = result.read(OUTPUT)
    try:
        # A program may have written this: nothing in it is trusted.
        answer = dict(json.loads(data))
        text, error, package = (str(answer[key]) for key in ("text", "error", "package"))
        defaults = {str(name): str(value) for name, value in dict(answer["defaults"]).items()}
        names, joints = frozenset(map(str, answer["arguments"])), map(int, answer["joints"])
        expansion = Expansion(text, defaults, names, request.packages, tuple(joints))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        limits = f"limits are {SECONDS} s, {BYTES / 1e9:g} GB and {OUTPUT / 1e6:g} MB of text"
        raise ConfinedError(f"its process ended with {ended}; {limits}") from None
    if error:
        raise ConfinedError(error, package, defaults)
    return expansion


class _Arguments(dict[str, str]):
    """Arguments of a xacro file, given values before defaults.

    It records what the file does with them.
    """

    def __init__(self, given: Mapping[str, str]) -> None:
        """Start with the given values."""
        super().__init__(given)
        self.names: set[str] = set()
        self.defaults: dict[str, str] = {}
        self.missing = ""

    def __contains__(self, name: object) -> bool:
        """Check whether a declared argument has a value."""
        self.names.add(str(name))
        return super().__contains__(name)

    def __setitem__(self, name: str, value: str) -> None:
        """Set a default."""
        self.defaults[name] = value
        super().__setitem__(name, value)

    def __getitem__(self, name: str) -> str:
        """Look up a value."""
        self.names.add(name)
        if not super().__contains__(name):
            self.missing = name
            raise ValueError(f"no value of {name}")
        return super().__getitem__(name)


def main(work: str, folders: Sequence[str]) -> None:
    """Confine this process, expand a file and print the result as JSON."""
    import xml.dom.expatbuilder  # noqa: F401  loaded now, because it may be unreadable later

    import xacro
    import yaml  # noqa: F401
    from xacro import substitution_args

    request = json.loads(work)
    answer: dict[str, Any] = {"text": "", "error": "", "package": "", "joints": []}
    arguments = _Arguments(request["sets"][0])

    def find(package: str) -> str:
        """Look up the folder of a package, without ROS's index."""
        if package not in request["packages"]:
            answer["package"] = package
            raise ValueError(f"there is no package {package}")
        return str(request["packages"][package])

    substitution_args._eval_find = substitution_args._eval_dict["find"] = find
    limit_resources(
        {"RLIMIT_CPU": SECONDS, "RLIMIT_AS": BYTES, "RLIMIT_FSIZE": OUTPUT, "RLIMIT_CORE": 0}
    )
    _confine([*sys.path, sys.prefix, sys.base_prefix, *folders])
    try:
        document = xacro.process_file(request["file"], mappings=arguments)
        answer["text"] = document.toxml()
    except Exception as error:  # whatever its macros raise
        # xacro repeats the text of an error, with the names of its types.
        answer["error"] = str(error) or type(error).__name__
        if arguments.missing:
            answer["error"] = _missing(request["file"], arguments)
    answer |= {"defaults": arguments.defaults, "arguments": sorted(arguments.names)}
    for values in request["sets"][1:]:
        try:
            document = xacro.process_file(request["file"], mappings=dict(values))
            joints = [j for j in document.documentElement.childNodes if j.nodeName == "joint"]
            answer["joints"].append(sum(j.getAttribute("type") in MOVING_TYPES for j in joints))
        except Exception:  # another set of arguments that is no robot
            answer["joints"].append(0)
    sys.stdout.write(json.dumps(answer))


def _missing(file: str, arguments: _Arguments) -> str:
    """Name every argument of a file that has no value; set the others to defaults.

    Defaults that xacro would have to evaluate are left out.
    """
    from xml.dom.minidom import parse

    missing = [arguments.missing]
    for node in parse(file).getElementsByTagName("xacro:arg"):
        name, default = node.getAttribute("name"), node.getAttribute("default")
        if name in arguments or name in missing:
            continue
        if not node.hasAttribute("default"):
            missing.append(name)
        elif "$(" not in default:
            arguments[name] = default
    named = ", ".join(f"`{name}`" for name in missing)
    needed = f"a value of its argument {named}"
    if len(missing) > 1:
        needed = f"values of its arguments {named}"
    return f"it needs {needed}: add {' '.join(f'--xacro-arg {name}:=VALUE' for name in missing)}"


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
