"""Which values of a job's files a study's parameter changes."""

from __future__ import annotations

from dualarm_cli.loading.amounts import in_unit, read_amount, scaled, shifted
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.quantities import QuantityError
from dualarm_cli.loading.schema_study import ParameterSection, TargetSection
from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.value_paths import PathError, find_value, to_pointer, value_at
from dualarm_cli.loading.yaml_source import Document, Loc
from dualarm_cli.model.study import Amount, Apply, Level, Span, Target

_MUST_BE_THERE = "; what a study varies must stand in the file, if only with its default"
_OF_THE_URDF = (".velocity", ".position", ".lower", ".upper")
_PAIR = ("robot.left", "robot.right")


class TargetReader:
    """Finds the values that paths lead to, in the files of all jobs, noting every error."""

    def __init__(
        self, document: Document, jobs: list[dict[str, Document]], findings: Findings
    ) -> None:
        """Stores the study file and the documents of its jobs, and where errors are noted."""
        self._document, self._jobs, self._findings = document, jobs, findings
        self._taken: dict[tuple[int, str], tuple[str, int]] = {}

    def read(
        self,
        section: ParameterSection,
        loc: Loc,
        name: str,
        values: tuple[tuple[Level, ...], Span | None],
    ) -> tuple[Target, ...]:
        """Returns a parameter's targets, without those that are wrong.

        Args:
            section: the parameter.
            loc: its place.
            name: what it is called.
            values: its values, or its span.
        """
        entries: list[tuple[TargetSection, Loc]]
        if section.targets is None:
            entries = [(section, loc)]
        else:
            entries = [(entry, (*loc, "targets", k)) for k, entry in enumerate(section.targets)]
        found = []
        for entry, place in entries:
            role, path = entry.given()[0]
            apply: Apply = entry.apply or section.apply or "set"
            found += self._target(role, path, apply, (*place, role), name, values)
        return tuple(found)

    def _target(
        self,
        role: str,
        path: str,
        apply: Apply,
        loc: Loc,
        name: str,
        values: tuple[tuple[Level, ...], Span | None],
    ) -> list[Target]:
        """Returns a target; of two robots that are meant together one for each."""
        roles = [role]
        if role == "robot" and any(pair in job for job in self._jobs for pair in _PAIR):
            roles = list(_PAIR)
        found = []
        for own in roles:
            keys, amounts = [], []
            for k, job in enumerate(self._jobs):
                place = self._place(job, own, path, loc)
                if place is None:
                    continue
                document = job[own]
                key = f"{own}:{to_pointer(place)}"
                self._claim(k, key, name, loc)
                value = value_at(document.data, place)
                keys.append(key)
                amounts.append(self._amount(value, apply, document, place, loc))
            if len(keys) == len(self._jobs) and self._fits(apply, amounts, values, loc):
                found.append(Target(own, path, apply, tuple(keys), tuple(amounts)))
        return found

    def _place(self, job: dict[str, Document], role: str, path: str, loc: Loc) -> Loc | None:
        """Returns where a path leads to in a job's file, or None after noting that it does not."""
        document = job.get(role)
        if document is None:
            known = ", ".join(job)
            message = (
                f"{job['tasks'].source.name} has no file {quote(role)}; its files are: {known}"
            )
            self._findings.add(self._document, loc, message, key=True)
            return None
        try:
            return find_value(document.data, path, document.source.name)
        except PathError as error:
            # Keys that a file leaves out have defaults; whoever varies one should see from which.
            hint = "" if "did you mean" in str(error) else _MUST_BE_THERE
            if role.startswith("robot") and path.endswith(_OF_THE_URDF):
                hint = "; position and velocity limits are the URDF's, and cannot be varied"
            self._findings.add(self._document, loc, f"{error}{hint * (' has no ' in str(error))}")
            return None

    def _claim(self, job: int, key: str, name: str, loc: Loc) -> None:
        """Notes a value that is changed twice."""
        line = self._document.place(loc)[0]
        other = self._taken.setdefault((job, key), (name, line))
        if other != (name, line):
            message = f"parameter {quote(other[0])} changes the same value, at line {other[1]}"
            self._findings.add(self._document, loc, message)

    def _amount(
        self, value: object, apply: Apply, document: Document, place: Loc, loc: Loc
    ) -> Level | None:
        """Returns a file's value, as a number if it is one; None after noting that it has to be one and is not."""
        try:
            return read_amount(value)
        except QuantityError:
            if apply == "set":
                return value if isinstance(value, str | bool) else None
        line, column = document.place(place)
        where = f"{document.source.name}:{line}:{column}"
        done = {"shift": "moved", "scale": "scaled"}[apply]
        message = f"only a number can be {done}, not {quote(value)} ({where}); write `apply: set`"
        self._findings.add(self._document, loc, message)
        return None

    def _fits(
        self,
        apply: Apply,
        amounts: list[Level | None],
        values: tuple[tuple[Level, ...], Span | None],
        loc: Loc,
    ) -> bool:
        """Returns whether the parameter's values can be applied to what the files have."""
        levels, span = values
        some = [span.low] if span is not None else list(levels[:1])
        if not some:
            return False  # the values are wrong, and that has been said
        level = some[0]
        for amount in amounts:
            try:
                if not isinstance(level, Amount):
                    if apply != "set":
                        raise QuantityError(f"{quote(level)} cannot {apply} a number")
                elif isinstance(amount, Amount) and apply == "set":
                    in_unit(level, amount)
                elif isinstance(amount, Amount):
                    shifted(amount, level) if apply == "shift" else scaled(amount, level)
                elif apply != "set":
                    return False
            except QuantityError as error:
                self._findings.add(self._document, loc, str(error))
                return False
        return True
