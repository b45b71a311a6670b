"""TextSource: an input file, read safely, with its lines and hash."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property
from pathlib import Path

from dualarm_cli.errors import Diagnostic, InputError, did_you_mean
from dualarm_cli.records import dataclass

MAX_FILE_BYTES = 20_000_000
"""Maximum size of an input file [bytes]."""
MAX_LISTED = 12
"""Maximum number of names in a message."""
_SNIPPET_LENGTH = 160
# U+0085, U+2028 and U+2029 end a line for some parsers only; line numbers would differ.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\ufffe\uffff]")

_READ: ContextVar[dict[str, str] | None] = ContextVar("read", default=None)


@contextmanager
def recorded_reads() -> Iterator[dict[str, str]]:
    """Record every input file read within the `with` block: SHA-256 by path as opened."""
    record: dict[str, str] = {}
    token = _READ.set(record)
    try:
        yield record
    finally:
        _READ.reset(token)


def suggest(
    word: str, choices: list[str], label: str = "allowed", most: int | None = MAX_LISTED
) -> str:
    """Compose the end of a message about an unknown word: the closest choice, then all choices.

    Args:
        word: the unknown word.
        choices: the valid words.
        label: heading of the list.
        most: maximum number listed; None for all.
    """
    shown = ", ".join(choices[:most]) or "none"
    more = f" and {len(choices) - most} more" if most is not None and len(choices) > most else ""
    hint = did_you_mean(word, choices)
    joint = f"{hint} {label.capitalize()}" if hint else f"; {label}"
    return f"{joint}: {shown}{more}"


def quote(value: object) -> str:
    """Format a value for messages: on one line, shortened, without control characters."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    text = value if isinstance(value, str) else repr(value)
    text = text if len(text) <= 60 else text[:57] + "..."
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return f"'{shown}'" if isinstance(value, str) else shown


@dataclass(frozen=True)
class TextSource:
    """The text of one input file."""

    name: str
    """Name of the file in messages."""
    text: str
    """Text with normalised line ends and without a byte order mark."""
    sha256: str
    """Hash of its bytes."""

    @cached_property
    def lines(self) -> list[str]:
        """Lines without line ends."""
        return self.text.split("\n")

    def snippet(self, line: int) -> str:
        """Format a source line for a terminal: control characters replaced, long lines cut."""
        if not 1 <= line <= len(self.lines):
            return ""
        text = self.lines[line - 1][:_SNIPPET_LENGTH]
        return "".join(
            c if c.isprintable() else " " if c == "\t" else "\N{MIDDLE DOT}" for c in text
        )

    def diagnostic(self, line: int, column: int, code: str, message: str) -> Diagnostic:
        """Create a diagnostic at a place of this file, with its snippet."""
        return Diagnostic(self.name, line, column, code, message, self.snippet(line))


def read_bytes(path: Path, name: str, limit: int = MAX_FILE_BYTES) -> bytes:
    """Read the bytes of a regular file, without blocking on a pipe.

    Args:
        path: file to read.
        name: what the user calls it.
        limit: maximum size [bytes].

    Raises:
        InputError: missing, unreadable, not a regular file, or too large.
    """
    try:
        # Without O_NONBLOCK opening a FIFO would wait for a writer forever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not the name of a file"
        raise _file_error(name, f"cannot be read: {reason}") from None
    status = os.fstat(descriptor)
    if stat.S_ISDIR(status.st_mode):
        os.close(descriptor)
        inside = ", ".join(sorted(entry.name for entry in path.glob("*.yaml"))[:MAX_LISTED])
        listed = f": {inside}" if inside.isprintable() and inside else ""
        raise _file_error(name, f"is a directory; name a file in it{listed}")
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(status.st_mode):
            raise _file_error(
                name, "is not a regular file (a pipe or a device); save it to a file first"
            )
        try:
            data = file.read(limit + 1) if status.st_size <= limit else b""
        except OSError as error:
            raise _file_error(name, f"cannot be read: {error.strerror}") from None
    if status.st_size > limit or len(data) > limit:
        size = max(status.st_size, len(data))
        raise _file_error(
            name, f"has {size / 1e6:.1f} MB; at most {limit / 1e6:g} MB are read", "E100"
        )
    record = _READ.get()
    if record is not None:
        record[str(path)] = hashlib.sha256(data).hexdigest()
    return data


def read_text(path: Path, name: str, limit: int = MAX_FILE_BYTES) -> TextSource:
    """Read the text of an input file.

    Args:
        path: file to read.
        name: what the user calls it.
        limit: maximum size [bytes].

    Raises:
        InputError: it cannot be read, is not UTF-8, or contains control characters.
    """
    data = read_bytes(path, name, limit)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise _file_error(name, "is UTF-16 or UTF-32; save it as UTF-8", "E101")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8-sig")
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        message = f"byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise InputError([Diagnostic(name, line, column, "E101", message)]) from None
    return text_source(text, name, hashlib.sha256(data).hexdigest())


def text_source(text: str, name: str, sha256: str | None = None) -> TextSource:
    """Check a text that is a file's content.

    Args:
        text: the text.
        name: what the user calls it.
        sha256: hash of the file's bytes; None for that of the text.

    Raises:
        InputError: it contains control characters.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    source = TextSource(name, text, sha256 or hashlib.sha256(text.encode()).hexdigest())
    bad = _FORBIDDEN.search(text)
    if bad:
        line = text.count("\n", 0, bad.start()) + 1
        column = bad.start() - text.rfind("\n", 0, bad.start())
        message = f"character U+{ord(bad[0]):04X} is not allowed; remove it"
        raise InputError([source.diagnostic(line, column, "E101", message)])
    return source


def _file_error(name: str, message: str, code: str = "E500") -> InputError:
    return InputError([Diagnostic(name, 0, 0, code, message)])
