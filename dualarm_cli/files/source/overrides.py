"""Overrides: values of a job's files that are replaced after reading and before validation, as a study does.

A key is the role of a file and a JSON pointer into it, such as `cell:/base/xyz/2` or `robot:/limits/torso_b1/jerk`.
`robot` means every robot file of the cell; of two robots `robot.left` and `robot.right` mean one. A file of a base
that the cell names is `base.left` or `base.right`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.records import dataclass

if TYPE_CHECKING:
    from dualarm_cli.files.source.yaml_source import Document

ROLES = ("tasks", "cell", "robot", "robot.left", "robot.right", "base.left", "base.right")
"""The files of a job, by what they are to it."""


@dataclass(frozen=True)
class Override:
    """A value that takes the place of a file's."""

    value: Any
    """What is put there, as the file would have it."""
    cause: str = ""
    """Who wants it, such as `parameter 'height'`."""
    at: Diagnostic | None = None
    """Where that is written; errors of the value are then told there."""

    def blame(self, found: Diagnostic, shown: str) -> Diagnostic:
        """Return a finding about the value as one about who wants it.

        Args:
            found: at the value's place in its file.
            shown: path of the value in the file.
        """
        if self.at is None:
            text = f"{shown} is replaced by {quote(self.value)}: {found.message}"
            return Diagnostic(found.file, found.line, found.column, found.code, text, found.snippet)
        text = f"{self.cause} makes {shown} of {found.file} {quote(self.value)}: {found.message}"
        return Diagnostic(
            self.at.file, self.at.line, self.at.column, found.code, text, self.at.snippet
        )


class Overrides:
    """What is replaced in the files of one job."""

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        """Sort values by file.

        Args:
            values: by key; plain, or as `Override`.

        Raises:
            InputError: a key that means nothing.
        """
        self._by_role: dict[str, dict[str, Override]] = {}
        self._left: dict[str, Override] = {}
        for key, value in (values or {}).items():
            role, _, pointer = key.partition(":")
            if role not in ROLES or not pointer.startswith("/"):
                known = ", ".join(ROLES)
                message = f"{key} leads nowhere: write a file ({known}), ':' and a JSON pointer"
                raise InputError([Diagnostic(key, 0, 0, "E300", message)])
            override = value if isinstance(value, Override) else Override(value)
            self._by_role.setdefault(role, {})[pointer] = override
            self._left[key] = override

    def apply(self, document: Document, role: str) -> None:
        """Replace values of a file that was just read.

        A key that a mapping lacks is added to it, as a person would who edits the file; an entry of a list is not.

        Args:
            document: the file; its data changes.
            role: what it is to the job.

        Raises:
            InputError: a pointer that leads nowhere.
        """
        from dualarm_cli.files.source.value_paths import (
            PathError,
            from_pointer,
            shown_path,
            value_at,
        )

        missing = []
        roles = dict.fromkeys((role.partition(".")[0] if role.startswith("robot") else role, role))
        for own in roles:
            for pointer, override in self._by_role.get(own, {}).items():
                self._left.pop(f"{own}:{pointer}", None)
                try:
                    loc = from_pointer(document.data, pointer, may_add=True)
                except PathError as error:
                    text = f"{own}:{pointer} leads nowhere: {error}"
                    found = document.diagnostic((), "E300", text)
                    missing.append(found if override.at is None else override.blame(found, pointer))
                    continue
                value_at(document.data, loc[:-1])[loc[-1]] = override.value
                document.replaced[loc] = (override, shown_path(document.data, loc))
        if missing:
            raise InputError(missing)

    def unused(self) -> list[Diagnostic]:
        """Return what is wrong where a job has no file of a role."""
        found = []
        for key, override in self._left.items():
            role, _, pointer = key.partition(":")
            plain = Diagnostic(role, 0, 0, "E300", f"this job has no file {quote(role)} of its own")
            found.append(override.blame(plain, pointer))
        return found
