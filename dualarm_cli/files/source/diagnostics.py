"""Conversion of pydantic's errors to diagnostics with places.

Codes: `explanations.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn, get_args

from dualarm_cli.errors import Diagnostic, DualArmError, InfeasibleError, InputError
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.refusals import few_at_each_place

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    from dualarm_cli.files.source.yaml_source import Document, Loc

MAX_MISTAKES = 100_000
"""Maximum number of errors of one file that are reported one by one."""
MAX_SHOWN = 20
"""Maximum number of diagnostics that are printed before the others are counted."""
_KINDS = {
    "string_type": "text (in quotes, if it looks like a number)",
    "list_type": "a list, such as [a, b]",
    "dict_type": "a mapping, such as {key: value}",
    "model_type": "a mapping, such as {key: value}",
    "bool_type": "true or false",
    "int_type": "a whole number",
}


class Findings:
    """Collector of everything wrong in one or more files."""

    def __init__(self, diagnostics: Iterable[Diagnostic] = ()) -> None:
        """Start with the findings of reading a file."""
        self.diagnostics: list[Diagnostic] = []
        self._unread: set[tuple[str, int, int]] = set()
        self.extend(diagnostics)

    def add(
        self,
        document: Document,
        loc: Iterable[str | int],
        message: str,
        code: str = "E300",
        key: bool = False,
        about: Mapping[str, object] | None = None,
    ) -> None:
        """Add one finding at a value or its key; `about` holds its data."""
        self.extend([replace(document.diagnostic(loc, code, message, key), about=about or {})])

    def extend(self, diagnostics: Iterable[Diagnostic]) -> None:
        """Add findings, except at places where a number was already unreadable (E104)."""
        fresh = [d for d in diagnostics if _place(d) not in self._unread]
        self._unread |= {_place(d) for d in fresh if d.code == "E104"}
        self.diagnostics += fresh

    def raise_if_any(self) -> None:
        """Raise all findings at once, by file and line.

        Raises:
            InputError: something was found.
        """
        if self.diagnostics:
            self.fail()

    def fail(self) -> NoReturn:
        """Raise InputError with all findings, by file and line, where reading cannot continue."""
        files = {d.file: None for d in self.diagnostics}
        order = {name: k for k, name in enumerate(files)}
        unique = dict.fromkeys(self.diagnostics)
        raise InputError(sorted(unique, key=lambda d: (order[d.file], d.line, d.column)))


def _place(diagnostic: Diagnostic) -> tuple[str, int, int]:
    return diagnostic.file, diagnostic.line, diagnostic.column


def schema_diagnostics(
    document: Document, model: type[BaseModel], error: ValidationError, prefix: Loc = ()
) -> list[Diagnostic]:
    """Convert the errors of a schema to diagnostics.

    Args:
        document: the file.
        model: what it was validated against.
        error: what came of it.
        prefix: where in the file the validated part stands.
    """
    if error.error_count() > MAX_MISTAKES:
        # Reported one by one they would take gigabytes; a program wrote such a file.
        message = (
            f"{error.error_count():,} mistakes in this file; correct the program that wrote it"
        )
        return [document.diagnostic(prefix, "E100", message)]
    diagnostics = []
    for item in error.errors(include_url=False):
        loc = tuple(item["loc"])
        kind, context = item["type"], item.get("ctx", {})
        at_key = kind == "extra_forbidden"
        code = "E201" if at_key else "E202" if kind == "missing" else "E200"
        if kind == "missing":
            message, loc = f"'{loc[-1]}' is missing", loc[:-1]
        elif at_key:
            message = _unknown_key(model, loc)
        else:
            message = _message(kind, item["msg"], item["input"], context)
            if kind in _KINDS and isinstance(item["input"], (dict, list)):
                # The value may begin a line further down than its key, so name the key.
                message = f"{_last_key(loc)}{message}"
            code = str(context.get("code", code))
            if context.get("key"):
                loc, at_key = (*loc, str(context["key"])), True
        diagnostics.append(document.diagnostic((*prefix, *loc), code, message, at_key))
    return diagnostics


def _message(kind: str, text: str, value: Any, context: dict[str, Any]) -> str:
    if kind in _KINDS:
        return f"must be {_KINDS[kind]}, not {quote(value)}"
    if kind == "literal_error":
        words = [w.strip("'") for w in str(context["expected"]).replace(" or ", ", ").split(", ")]
        return f"{quote(value)} is not allowed{suggest(str(value), words)}"
    if kind in ("too_short", "too_long"):
        least, most = context.get("min_length"), context.get("max_length")
        wanted = (
            f"at least {least} are needed" if least is not None else f"at most {most} are allowed"
        )
        return f"a list of {context['actual_length']} is too {kind[4:]}; {wanted}"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        bound = next(context[k] for k in ("gt", "ge", "lt", "le") if k in context)
        words_of = {"greater_than": "above", "less_than": "below"}
        relation = words_of.get(kind, "at least" if kind == "greater_than_equal" else "at most")
        return f"{quote(value)} must be {relation} {bound:g}"
    # The message of one of our validators: pydantic would put its own words before it.
    return str(context["error"]) if kind == "value_error" else text


def _last_key(loc: Loc) -> str:
    """Quote the key of a value; empty for an item of a list."""
    return f"'{loc[-1]}' " if loc and isinstance(loc[-1], str) else ""


REMOVED_KEYS = {
    "dwell_motion": "joints stand while tools dwell",
    "line_motion": "the platform stands while tools are on lines",
}
"""Keys of earlier versions, with the behaviour of this version."""


def _unknown_key(model: type[BaseModel], loc: Loc) -> str:
    """Compose the message for an unknown key."""
    if why := REMOVED_KEYS.get(str(loc[-1])):
        return f"key {quote(loc[-1])} was removed: {why}; delete it"
    holder = _model_at(model, loc[:-1])
    keys = [field.alias or name for name, field in holder.model_fields.items()] if holder else []
    return f"unknown key {quote(loc[-1])}{suggest(str(loc[-1]), keys, most=None)}"


def _model_at(model: type[BaseModel], loc: Loc) -> type[BaseModel] | None:
    """Find the pydantic model of the mapping at a place."""
    current: Any = model
    for step in loc:
        holder = _as_model(current)
        if holder is None:
            current = _bare(current)
            current = next((a for a in reversed(_arguments(current)) if a is not type(None)), None)
            continue
        fields = {
            field.alias or name: field.annotation for name, field in holder.model_fields.items()
        }
        current = fields.get(str(step))
    return _as_model(current)


def _bare(annotation: Any) -> Any:
    """Unwrap the list or mapping in `list | None` or `Annotated[list, …]`."""
    while getattr(annotation, "__origin__", None) not in (list, dict):
        inner = [a for a in _arguments(annotation) if a is not type(None)]
        if not inner:
            break
        annotation = inner[0]
    return annotation


def _as_model(annotation: Any) -> type[BaseModel] | None:
    """Unwrap the model in `Model`, `Model | None` or `Annotated[Model, …]`."""
    if hasattr(annotation, "model_fields"):
        return annotation
    if getattr(annotation, "__origin__", None) in (list, dict):
        return None
    return next((m for a in _arguments(annotation) if (m := _as_model(a)) is not None), None)


def _arguments(annotation: Any) -> Sequence[Any]:
    return get_args(annotation)


def error_text(error: DualArmError) -> str:
    """Format any error for a terminal, with the commands that explain its codes."""
    if isinstance(error, InputError):
        text, codes = render(error.diagnostics), [d.code for d in error.diagnostics]
    else:
        codes = [code] if (code := getattr(error, "code", "")) else []
        begin = "".join(["error", *(f"[{code}]" for code in codes), ": "])
        text = error.message(begin) if isinstance(error, InfeasibleError) else f"{begin}{error}"
    commands = ", ".join(f"`dualarm explain {code}`" for code in dict.fromkeys(codes))
    return f"{text}\nMore about it: {commands}" if codes else text


def render(diagnostics: list[Diagnostic]) -> str:
    """Format diagnostics as errors with source line and a caret below the column.

    The first MAX_SHOWN are shown, few of the same kind and place; the rest is counted.
    """
    places = [(d.place, d.code) if d.about else None for d in diagnostics]
    few = list(few_at_each_place(diagnostics, places))
    parts = [_render_one(diagnostic) + more for diagnostic, more in few[:MAX_SHOWN]]
    more = len(few) - MAX_SHOWN
    if more > 0:
        parts.append(f"... and {more} more")
    return "\n".join(parts)


def _render_one(diagnostic: Diagnostic) -> str:
    text = f"error[{diagnostic.code}]: {diagnostic.place}: {diagnostic.message}"
    text = "".join(c if c.isprintable() else "\N{MIDDLE DOT}" for c in text)
    if not diagnostic.snippet:
        return text
    number = str(diagnostic.line)
    line = f"  {number} | {diagnostic.snippet}"
    if not 0 < diagnostic.column <= len(diagnostic.snippet) + 1:
        return f"{text}\n{line}"
    return f"{text}\n{line}\n  {' ' * len(number)} | {' ' * (diagnostic.column - 1)}^"
