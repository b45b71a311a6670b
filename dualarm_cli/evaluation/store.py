"""Store of evaluations, in a folder that several processes may use at once.

Each entry is a separate file with a checksum, written to a temporary file and then moved. Truncated, changed or foreign
entries count as missing. There are no locks: concurrent writers of an entry write the same content.

`answers/` holds evaluations by `answer_key`, and `pages/` requested page data by the same key. `files/` holds the names
of the files read for a task file of given content; with their present hashes the key of the answer is computed without
reading the job.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from dualarm_cli.errors import InputError, OutputError
from dualarm_cli.evaluation.fingerprint import (
    GONE,
    answer_key,
    canonical,
    digest,
    hashes_now,
    question,
)
from dualarm_cli.evaluation.request import Request
from dualarm_cli.exporting.whole_files import place_in, write_new
from dualarm_cli.files.source.text_source import read_bytes
from dualarm_cli.model.studies.evaluation import REPEATABLE, Evaluation

FORMAT = "dualarm.cache/1"
DEFAULT_FOLDER = ".dualarm-cache"
"""Default folder of the store in the working directory."""
ABANDONED = 3600.0
"""Age from which a temporary file counts as left by a killed process [s]."""
ROUNDING = 1e-9
"""Relative tolerance between figures of one plan."""
MOST_BYTES = 50_000_000
"""Maximum size of an entry, and of an unpacked page [B]."""


class Store:
    """Store of evaluations."""

    def __init__(self, folder: Path) -> None:
        """Open a store; its folder is created on the first write."""
        self.folder = folder
        self.problem = ""
        """Reason why an answer could not be written; empty if all could."""
        self._hashes: dict[str, str] = {}
        _remove_abandoned(folder / "making")

    def find(self, request: Request) -> Evaluation | None:
        """Look up the answer for a request's present files, or return None.

        An answer without the requested page counts as missing.
        """
        names = self._read("files", self._files_key(request))
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            return None
        inputs = hashes_now(names, request.folder, self._hashes)
        key = answer_key(request, inputs)
        document = self._read("answers", key)
        try:
            evaluation = Evaluation.of_document(document)
        except ValueError:
            return None
        matches = evaluation.case == request.case and dict(evaluation.inputs) == inputs
        if not (matches and evaluation.status in REPEATABLE and _adds_up(evaluation)):
            return None
        longer = request.above is not None and (evaluation.cycle_time or 0.0) > request.above
        if longer and not evaluation.schedule:
            return None  # planned when nothing asked for the schedule
        if not request.page or evaluation.status == "infeasible":
            return evaluation
        # This import loads numpy, which answers alone do not need.
        from dualarm_cli.page.packed import unpacked_document

        page = self._read("pages", key)
        try:
            unpacked_document(str(page), MOST_BYTES)
        except ValueError:
            return None
        return replace(evaluation, page=str(page))

    def keep(self, request: Request, answer: Evaluation) -> None:
        """Store an answer if it is repeatable and its files are unchanged.

        If it cannot be written, `problem` has the reason.
        """
        if answer.status not in REPEATABLE or not answer.inputs:
            return
        if hashes_now(answer.inputs, request.folder, {}) != dict(answer.inputs):
            return
        files = self._files_key(request, fresh=True)
        try:
            key = answer_key(request, answer.inputs)
            self._write("answers", key, replace(answer, page="").as_document())
            if answer.page:
                self._write("pages", key, answer.page)
            self._write("files", files, list(answer.inputs))
        except OSError as error:
            self.problem = self.problem or (error.strerror or type(error).__name__)

    def _files_key(self, request: Request, fresh: bool = False) -> str:
        """Compute the key of a task file's list of files.

        It depends on the file's name, content and replaced values.
        """
        hashes = {} if fresh else self._hashes
        held = hashes_now([request.file], request.folder, hashes)[request.file]
        return digest({"question": question(request), "task": held if held != GONE else ""})

    def _place(self, kind: str, key: str) -> Path:
        return self.folder / kind / key[:2] / f"{key[2:]}.json"

    def _read(self, kind: str, key: str) -> Any:
        """Read the content of an entry; None if it is missing or damaged."""
        try:
            entry = json.loads(read_bytes(self._place(kind, key), key, MOST_BYTES))
        except (InputError, ValueError, RecursionError):
            return None
        if not isinstance(entry, dict) or entry.get("format") != FORMAT or entry.get("key") != key:
            return None
        content = entry.get("content")
        try:
            whole = entry.get("sha256") == _checksum(content)
        except (ValueError, RecursionError):
            return None
        return content if whole else None

    def _write(self, kind: str, key: str, content: Any) -> None:
        """Write an entry atomically.

        Raises:
            OSError: it cannot be written.
        """
        ignore = self.folder / ".gitignore"
        if not ignore.exists():
            self._move_in(ignore, b"# made by dualarm; may be deleted at any time\n*\n")
        entry = {"format": FORMAT, "key": key, "sha256": _checksum(content), "content": content}
        self._move_in(self._place(kind, key), canonical(entry).encode())

    def _move_in(self, place: Path, data: bytes) -> None:
        """Write a file to a temporary place, flush it, and move it.

        Raises:
            OSError: it cannot be written.
        """
        making = self.folder / "making"
        try:
            for folder in (making, place.parent):
                place_in(self.folder, str(folder.relative_to(self.folder)))
                folder.mkdir(parents=True, exist_ok=True)
        except OutputError as error:
            raise OSError(0, str(error)) from None
        temporary = write_new(making, [data])
        try:
            temporary.replace(place)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise


def _adds_up(evaluation: Evaluation) -> bool:
    """Check that an answer's figures are consistent; its checksum only detects truncation."""
    time, bound, gap = evaluation.cycle_time, evaluation.lower_bound, evaluation.gap
    if evaluation.status == "infeasible":
        return time is None
    if time is None or time < 0.0:
        return False
    if bound is None or time == 0.0:
        return gap is None
    return (
        bound <= time * (1.0 + ROUNDING)
        and gap is not None
        and abs(gap - (time - bound) / time) <= ROUNDING
    )


def _checksum(content: Any) -> str:
    return hashlib.sha256(canonical(content).encode()).hexdigest()


def _remove_abandoned(folder: Path) -> None:
    """Remove unfinished files of killed processes from the folder itself."""
    with contextlib.suppress(OSError):
        for path in () if folder.is_symlink() else folder.iterdir():
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > ABANDONED:
                    path.unlink()
