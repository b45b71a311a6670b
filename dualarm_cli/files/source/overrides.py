"""Overrides: values of a job's files, replaced after reading and before validation, for studies.

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
"""Roles of the files of a job."""


@dataclass(frozen=True)
class Override:
    """Replacement for a value of a file."""

    value: Any
    """New value, in the form of the file."""
    cause: str = ""
    """Origin of the value, such as `parameter 'height'`."""
    at: Diagnostic | None = None
    """Place of the origin, where errors of the value are reported."""

    def blame(self, finding: Diagnostic, shown: str) -> Diagnostic:
        """Convert a finding about the value to one about its origin.

        Args:
            finding: at the value's place in its file.
            shown: path of the value in the file.
        """
        if self.at is None:
            text = f"{shown} is replaced by {quote(self.value)}: {finding.message}"
            return Diagnostic(
                finding.file, finding.line, finding.column, finding.code, text, finding.snippet
            )
        text = (
            f"{self.cause} makes {shown} of {finding.file} {quote(self.value)}: {finding.message}"
        )
        return Diagnostic(
            self.at.file, self.at.line, self.at.column, finding.code, text, self.at.snippet
        )


def _plain(value: Any) -> Any:
    """Convert arrays, numpy scalars and tuples to lists and plain numbers, at any depth."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, list | tuple) else value


class Overrides:
    """Replacements in the files of one job."""

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        """Sort values by file.

        Args:
            values: by key; plain, or as `Override`.

        Raises:
            InputError: an invalid key.
        """
        self._by_role: dict[str, dict[str, Override]] = {}
        self._unused: dict[str, Override] = {}
        for key, value in (values or {}).items():
            role, _, pointer = key.partition(":")
            if role not in ROLES or not pointer.startswith("/"):
                roles = ", ".join(ROLES)
                message = f"{key} leads nowhere: write a file ({roles}), ':' and a JSON pointer"
                raise InputError([Diagnostic(key, 0, 0, "E300", message)])
            override = value if isinstance(value, Override) else Override(_plain(value))
            self._by_role.setdefault(role, {})[pointer] = override
            self._unused[key] = override

    def apply(self, document: Document, role: str) -> None:
        """Replace values of a file that was just read.

        A missing key of a mapping is added; a missing entry of a list is an error.

        Args:
            document: the file; its data changes.
            role: its role in the job.

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
        for applicable in roles:
            for pointer, override in self._by_role.get(applicable, {}).items():
                self._unused.pop(f"{applicable}:{pointer}", None)
                try:
                    loc = from_pointer(document.data, pointer, may_add=True)
                except PathError as error:
                    text = f"{applicable}:{pointer} leads nowhere: {error}"
                    finding = document.diagnostic((), "E300", text)
                    missing.append(
                        finding if override.at is None else override.blame(finding, pointer)
                    )
                    continue
                value_at(document.data, loc[:-1])[loc[-1]] = override.value
                document.replaced[loc] = (override, shown_path(document.data, loc))
        if missing:
            raise InputError(missing)

    def unused(self) -> list[Diagnostic]:
        """Report overrides of files that the job does not have."""
        findings = []
        for key, override in self._unused.items():
            role, _, pointer = key.partition(":")
            plain = Diagnostic(role, 0, 0, "E300", f"this job has no file {quote(role)}")
            findings.append(override.blame(plain, pointer))
        return findings
