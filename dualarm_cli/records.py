"""Frozen dataclasses with a fast import.

`dataclasses.dataclass` compiles six functions for each frozen class. With some 450 classes that took a third of the
planner's import time. Here only `__init__` is compiled, when a class is first used, and all classes share the other
functions.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Sequence, Sized
from importlib import import_module
from itertools import accumulate
from operator import attrgetter
from reprlib import recursive_repr
from types import FunctionType
from typing import TYPE_CHECKING, Any, TypeVar

T = TypeVar("T")
LONGEST_TEXT = 160
"""Number of characters of a record's fields above which its text is shortened."""

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, eq=True):
        """Make a class a dataclass, like `dataclasses.dataclass` with the same arguments."""
        if cls is None:
            return lambda class_: dataclass(class_, frozen=frozen, eq=eq)
        if not frozen or _is_special(cls):
            return dataclasses.dataclass(cls, frozen=frozen, eq=eq)
        return _frozen(cls, eq)


class ShownInNotebooks:
    """Base of objects that notebooks show with figures and a picture."""

    def _repr_html_(self) -> str:
        # Pictures are a layer above: they are imported when one is shown.
        html: str = import_module("dualarm_cli.report.figures.notebook").html_of(self)
        return html


def field_values(record: Any) -> dict[str, Any]:
    """Return the values of a record's fields by name, without copies."""
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def _is_special(cls: type) -> bool:
    """Check whether a class needs the standard library's dataclass."""
    overridden = {"__init__", "__eq__", "__hash__", "__setattr__", "__delattr__"}
    annotated = vars(cls).get("__annotations__", {})
    values = [vars(cls).get(name) for name in annotated]
    fields = [value for value in values if isinstance(value, dataclasses.Field)]
    return (
        bool(overridden & set(vars(cls)))
        or any("InitVar" in str(kind) or "KW_ONLY" in str(kind) for kind in annotated.values())
        or any(f.hash is not None or f.kw_only is True for f in fields)
    )


def _frozen(cls: type[T], eq: bool) -> type[T]:
    """Make a class a frozen dataclass."""
    # The standard library refuses an unfrozen subclass of a frozen class; other classes need two functions less.
    derived = any(dataclasses.is_dataclass(base) for base in cls.__mro__[1:])
    class_ = dataclasses.dataclass(init=False, repr=False, eq=False, frozen=derived)(cls)
    parameters = class_.__dataclass_params__  # type: ignore[attr-defined]
    parameters.init = parameters.repr = parameters.frozen = True
    parameters.eq = eq
    fields = dataclasses.fields(class_)  # type: ignore[arg-type]
    methods: dict[str, Any] = {
        "__init__": _LateInit(class_, fields),
        "__repr__": _repr([f.name for f in fields if f.repr]),
        "__setattr__": _set_attribute,
        "__delattr__": _delete_attribute,
    }
    if eq:
        values = _values([f.name for f in fields if f.compare])
        methods["__eq__"], methods["__hash__"] = _eq(values), _hash(values)
    for name, function in methods.items():
        if name != "__repr__" or name not in vars(cls):
            setattr(class_, name, function)
    return class_


class _FactoryMarker:
    """Placeholder of a default that a factory makes at each call."""

    def __repr__(self) -> str:
        return "<factory>"


_FACTORY = _FactoryMarker()


class _LateInit:
    """Descriptor that compiles `__init__` of a class at its first use.

    It sets the fields and calls `__post_init__` if defined. A plan makes objects of a third of all classes.
    """

    def __init__(self, cls: type, fields: Sequence[dataclasses.Field[Any]]) -> None:
        """Note the class; the order of defaults is checked at once."""
        positional = [f for f in fields if f.init and f.kw_only is not True]
        has_default = False
        for f in positional:
            missing = f.default is f.default_factory is dataclasses.MISSING
            if missing and has_default:
                raise TypeError(f"non-default argument {f.name!r} follows default argument")
            has_default = not missing
        self.cls, self.fields = cls, fields

    def __get__(self, record: object, owner: type) -> Any:
        """Make the function, and put it in the place of this descriptor."""
        init = _compiled(self.cls, self.fields)
        self.cls.__init__ = init  # type: ignore[misc]
        return init if record is None else init.__get__(record, owner)


def _compiled(cls: type, fields: Sequence[dataclasses.Field[Any]]) -> FunctionType:
    """Compile `__init__` of a class.

    Args:
        cls: the class; annotations are looked up in its module.
        fields: fields to set.
    """
    this = "self" if all(f.name != "self" for f in fields) else "__self__"
    constants: dict[str, Any] = {"__set__": object.__setattr__, "__factory__": _FACTORY}
    arguments, lines = [this], []
    for field in fields:
        name = value = argument = field.name
        has_factory = field.default_factory is not dataclasses.MISSING
        default = f"__of_{name}__"
        if has_factory:
            constants[default] = field.default_factory
            argument = f"{name}=__factory__"
            value = f"{default}() if {name} is __factory__ else {name}"
        elif field.default is not dataclasses.MISSING:
            constants[default] = field.default
            argument = f"{name}={default}"
        if field.init:
            arguments.append(argument)
            lines.append(f"__set__({this}, {name!r}, {value})")
        elif has_factory:
            lines.append(f"__set__({this}, {name!r}, {default}())")
    if hasattr(cls, "__post_init__"):
        lines.append(f"{this}.__post_init__()")
    body = "\n  ".join(lines or ["pass"])
    text = f"def of({', '.join(constants)}):\n def __init__({', '.join(arguments)}):\n  {body}\n return __init__"
    namespace: dict[str, Any] = {}
    exec(text, vars(sys.modules[cls.__module__]), namespace)
    init: FunctionType = namespace["of"](**constants)
    init.__qualname__ = f"{cls.__qualname__}.__init__"
    init.__annotations__ = {f.name: f.type for f in fields if f.init} | {"return": None}
    return init


def _repr(names: Sequence[str]) -> Callable[[Any], str]:
    """Make `__repr__` of a class from the names of its fields.

    A text of several lines or over LONGEST_TEXT has types and sizes in place of long values, and ends there.
    """

    @recursive_repr()
    def __repr__(self: Any) -> str:
        shown = [f"{name}={getattr(self, name)!r}" for name in names]
        if sum(map(len, shown)) > LONGEST_TEXT or any("\n" in text for text in shown):
            shown = [f"{name}={_brief(getattr(self, name))}" for name in names]
            ends = accumulate(len(text) + 2 for text in shown)
            kept = sum(end <= LONGEST_TEXT for end in ends)
            shown = [*shown[:kept], *(["..."] if kept < len(shown) else [])]
        return f"{type(self).__qualname__}({', '.join(shown)})"

    return __repr__


def _brief(value: object) -> str:
    """Describe a value in a few words: itself, or its type and size."""
    text = repr(value)
    if len(text) <= 44 and "\n" not in text:
        return text
    size = getattr(value, "shape", None) or (len(value) if isinstance(value, Sized) else "")
    return f"<{type(value).__name__}{size and f' of {size}'}>"


def _values(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Make a function that collects the values of an object's fields."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda record: tuple(getattr(record, name) for name in names)


def _eq(values: Callable[[Any], tuple[Any, ...]]) -> Callable[[Any, object], bool]:
    """Make `__eq__` of a class from its compared values, as a tuple.

    Tuples count identical objects as equal.
    """

    def __eq__(self: Any, record: object) -> bool:
        return values(self) == values(record) if type(record) is type(self) else NotImplemented

    return __eq__


def _hash(values: Callable[[Any], tuple[Any, ...]]) -> Callable[[Any], int]:
    """Make `__hash__` of a class from its compared values."""

    def __hash__(self: Any) -> int:
        return hash(values(self))

    return __hash__


def _is_fixed(self: object, name: str) -> bool:
    """Check whether an attribute is frozen: a field, or any attribute of a dataclass.

    Derived plain classes may have further attributes.
    """
    return "__dataclass_fields__" in vars(type(self)) or name in self.__dataclass_fields__  # type: ignore[attr-defined]


def _set_attribute(self: object, name: str, value: object) -> None:
    if _is_fixed(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
    object.__setattr__(self, name, value)


def _delete_attribute(self: object, name: str) -> None:
    if _is_fixed(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
    object.__delattr__(self, name)
