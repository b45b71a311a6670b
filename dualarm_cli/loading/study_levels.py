"""What values a study's parameter takes."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

from dualarm_cli.loading.amounts import one_unit, read_amount
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.quantities import QuantityError
from dualarm_cli.loading.schema_study import MOST_LEVELS, ParameterSection, RangeSection
from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.yaml_source import Document, Loc
from dualarm_cli.model.study import Amount, Level, Span, tidy


class LevelReader:
    """Reads the values of parameters, noting every error."""

    def __init__(self, document: Document, findings: Findings) -> None:
        """Stores the study file, and where errors are noted."""
        self._document, self._findings = document, findings

    def read(self, section: ParameterSection, loc: Loc) -> tuple[tuple[Level, ...], Span | None]:
        """Returns a parameter's values, or its span where it has no steps; nothing after noting an error.

        Args:
            section: the parameter.
            loc: its place.
        """
        if section.range is not None:
            return self._range(section.range, (*loc, "range"))
        return self._values(section.values or [], (*loc, "values")), None

    def _values(self, values: list[Any], loc: Loc) -> tuple[Level, ...]:
        """Returns listed values: numbers of one unit, or words, or true and false."""
        amounts: list[Amount] = []
        problems: list[tuple[int, str]] = []
        for k, value in enumerate(values):
            if isinstance(value, dict | list) or value is None:
                message = f"must be a number, text, true or false, not {quote(value)}"
                self._findings.add(self._document, (*loc, k), message, "E200")
                return ()
            try:
                amounts.append(read_amount(value))
            except QuantityError as error:
                problems.append((k, str(error)))
        levels: list[Level]
        if not problems:
            levels = list(self._same_unit(amounts, [(*loc, k) for k in range(len(values))]))
        elif amounts:
            k, message = problems[0]
            self._findings.add(
                self._document, (*loc, k), f"{message}; the others are numbers", "E200"
            )
            return ()
        else:
            levels = list(values)
        for k, level in enumerate(levels):
            # True is no 1: a boolean is not an Amount.
            if level in levels[:k]:
                self._findings.add(
                    self._document, (*loc, k), f"{quote(values[k])} is there twice", "E102"
                )
        return tuple(levels)

    def _range(self, section: RangeSection, loc: Loc) -> tuple[tuple[Level, ...], Span | None]:
        given = {"from": section.from_, "to": section.to}
        if section.step is not None:
            given["step"] = section.step
        amounts = []
        for key, value in given.items():
            try:
                amounts.append(read_amount(value))
            except QuantityError as error:
                self._findings.add(self._document, (*loc, key), str(error), "E200")
        if len(amounts) < len(given):
            return (), None
        amounts = self._same_unit(amounts, [(*loc, key) for key in given])
        if not amounts:
            return (), None
        low, high = amounts[:2]
        if not low.number < high.number:
            message = f"must be above 'from' ({quote(section.from_)}), not {quote(section.to)}"
            self._findings.add(self._document, (*loc, "to"), message, "E200")
            return (), None
        if section.step is not None:
            return self._steps(low, high, amounts[2], (*loc, "step")), None
        if section.count is not None:
            return _evenly(low, high, section.count), None
        return (), Span(low, high)

    def _steps(self, low: Amount, high: Amount, step: Amount, loc: Loc) -> tuple[Level, ...]:
        """Returns from, from + step and so on to the end, in decimals as people count."""
        if step.number <= 0.0:
            self._findings.add(self._document, loc, "a step must be above 0", "E200")
            return ()
        first, by, last = (Decimal(repr(a.number)) for a in (low, step, high))
        count = int((last - first) / by) + 1
        if count > MOST_LEVELS:
            message = f"makes {count} values; at most {MOST_LEVELS}: write a longer step"
            self._findings.add(self._document, loc, message, "E200")
            return ()
        end = first + (count - 1) * by
        if end != last:
            ends = Amount(float(end), low.unit).shown
            message = f"steps of {step.shown} from {low.shown} end at {ends}, not at {high.shown}; change step or to"
            self._findings.add(self._document, loc, message, "E200")
            return ()
        whole = all(isinstance(a.number, int) for a in (low, step))
        numbers = [first + k * by for k in range(count)]
        return tuple(_like(low, int(n) if whole else tidy(float(n))) for n in numbers)

    def _same_unit(self, amounts: list[Amount], locs: list[Loc]) -> list[Amount]:
        """Returns amounts in one unit, or nothing after noting one that is of another dimension."""
        try:
            return one_unit(amounts)
        except QuantityError as error:
            self._findings.add(self._document, locs[-1], f"not of one dimension: {error}", "E200")
            return []


def _evenly(low: Amount, high: Amount, count: int) -> tuple[Level, ...]:
    """Returns numbers evenly spread, both ends among them; whole ones where all of them are."""
    span = high.number - low.number
    numbers = [tidy(low.number + span * k / (count - 1)) for k in range(count)]
    whole = isinstance(low.number, int) and all(number.is_integer() for number in numbers)
    return tuple(_like(low, int(n) if whole else n) for n in numbers)


def _like(amount: Amount, number: float) -> Amount:
    return Amount(number, amount.unit, amount.factor, amount.base)
