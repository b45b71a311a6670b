"""Dataclasses that load quickly.

`dataclasses.dataclass` compiles six functions for each frozen class, and this package has some 450 of them: before,
a third of the time in which the planner loads. Here only `__init__` is compiled, once for all classes that differ in
the names of their fields alone, and all classes share the other functions.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter
from reprlib import recursive_repr
from types import FunctionType
from typing import TYPE_CHECKING, Any, TypeVar

T = TypeVar("T")

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, eq=True):
        """Makes a class a dataclass, as `dataclasses.dataclass` does with the same arguments."""
        if cls is None:
            return lambda made: dataclass(made, frozen=frozen, eq=eq)
        if not frozen or _is_special(cls):
            return dataclasses.dataclass(cls, frozen=frozen, eq=eq)
        return _frozen(cls, eq)


def field_values(record: Any) -> dict[str, Any]:
    """Returns the values of a record's fields by name, as they are; `dataclasses.asdict` copies all that is in them."""
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def _is_special(cls: type) -> bool:
    """Returns whether a class asks for what only the standard library does."""
    own = {"__init__", "__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__"}
    annotated = vars(cls).get("__annotations__", {})
    values = [vars(cls).get(name) for name in annotated]
    fields = [value for value in values if isinstance(value, dataclasses.Field)]
    return (
        bool(own & set(vars(cls)))
        or any("InitVar" in str(kind) or "KW_ONLY" in str(kind) for kind in annotated.values())
        or any(f.hash is not None or f.kw_only is True for f in fields)
    )


def _frozen(cls: type[T], eq: bool) -> type[T]:
    """Returns a class as a frozen dataclass."""
    # The standard library refuses a class that is not frozen under one that is; else it is spared two functions.
    derived = any(dataclasses.is_dataclass(base) for base in cls.__mro__[1:])
    made = dataclasses.dataclass(init=False, repr=False, eq=False, frozen=derived)(cls)
    parameters = made.__dataclass_params__  # type: ignore[attr-defined]
    parameters.init = parameters.repr = parameters.frozen = True
    parameters.eq = eq
    fields = dataclasses.fields(made)  # type: ignore[arg-type]
    added: dict[str, Any] = {
        "__init__": _init(made, fields),
        "__repr__": _repr([f.name for f in fields if f.repr]),
        "__setattr__": _set_attribute,
        "__delattr__": _delete_attribute,
    }
    if eq:
        values = _values([f.name for f in fields if f.compare])
        added["__eq__"], added["__hash__"] = _eq(values), _hash(values)
    for name, function in added.items():
        setattr(made, name, function)
    return made


class _Made:
    """What stands for a default that is made anew each time."""

    def __repr__(self) -> str:
        return "<factory>"


_MADE = _Made()


def _init(cls: type, fields: Sequence[dataclasses.Field[Any]]) -> Callable[..., None]:
    """Returns `__init__` of a class, which sets its fields, and calls `__post_init__` if there is one."""
    has_post_init, module = hasattr(cls, "__post_init__"), vars(sys.modules[cls.__module__])
    this = "self" if all(f.name != "self" for f in fields) else "__self__"
    if any(f.default_factory is not dataclasses.MISSING or not f.init for f in fields):
        made = _compiled(this, fields, has_post_init, module)
    else:
        defaults = [f.default for f in fields if f.default is not dataclasses.MISSING]
        for f in fields[len(fields) - len(defaults) :]:
            if f.default is dataclasses.MISSING:
                raise TypeError(f"non-default argument {f.name!r} follows default argument")
        template = _positional_init(len(fields), has_post_init)
        made = _renamed(template, (this, *(f.name for f in fields)), module)
        made.__defaults__ = tuple(defaults)
    made.__qualname__ = f"{cls.__qualname__}.__init__"
    made.__annotations__ = {f.name: f.type for f in fields if f.init} | {"return": None}
    return made


def _compiled(
    this: str, fields: Sequence[dataclasses.Field[Any]], has_post_init: bool, module: dict[str, Any]
) -> FunctionType:
    """Returns an `__init__` with the names of some fields, compiled.

    Args:
        this: what it calls the object.
        fields: what it sets.
        has_post_init: whether `__post_init__` is called.
        module: names of the class's module, in which annotations are looked up.
    """
    known: dict[str, Any] = {"__set__": object.__setattr__, "__made__": _MADE}
    arguments, lines = [this], []
    for field in fields:
        name = value = argument = field.name
        is_made = field.default_factory is not dataclasses.MISSING
        default = f"__of_{name}__"
        if is_made:
            known[default] = field.default_factory
            argument = f"{name}=__made__"
            value = f"{default}() if {name} is __made__ else {name}"
        elif field.default is not dataclasses.MISSING:
            known[default] = field.default
            argument = f"{name}={default}"
        if field.init:
            arguments.append(argument)
            lines.append(f"__set__({this}, {name!r}, {value})")
        elif is_made:
            lines.append(f"__set__({this}, {name!r}, {default}())")
    if has_post_init:
        lines.append(f"{this}.__post_init__()")
    body = "\n  ".join(lines or ["pass"])
    text = f"def of({', '.join(known)}):\n def __init__({', '.join(arguments)}):\n  {body}\n return __init__"
    found: dict[str, Any] = {}
    exec(text, module, found)
    made: FunctionType = found["of"](**known)
    return made


@cache
def _positional_init(count: int, has_post_init: bool) -> FunctionType:
    """Returns an `__init__` of so many fields that are named by their places: most classes differ in names alone."""
    fields = [dataclasses.field() for _ in range(count)]
    for k, field in enumerate(fields):
        field.name = f"_{k}"
    return _compiled("_self", fields, has_post_init, {})


def _renamed(
    template: FunctionType, names: tuple[str, ...], module: dict[str, Any]
) -> FunctionType:
    """Returns an `__init__` with other names for its arguments, which it sets by names that are constants.

    Args:
        template: the function.
        names: all arguments'.
        module: the globals that it gets.
    """
    code = template.__code__
    named: dict[Any, Any] = dict(zip(code.co_varnames, names, strict=True))
    renamed = code.replace(
        co_varnames=names, co_consts=tuple(named.get(one, one) for one in code.co_consts)
    )
    return FunctionType(renamed, module, template.__name__, None, template.__closure__)


def _repr(names: Sequence[str]) -> Callable[[Any], str]:
    """Returns `__repr__` of a class by the names of its fields."""

    @recursive_repr()
    def __repr__(self: Any) -> str:
        shown = ", ".join(f"{name}={getattr(self, name)!r}" for name in names)
        return f"{type(self).__qualname__}({shown})"

    return __repr__


def _values(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Returns a function that returns the values (n,) of an object's fields."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda one: tuple(getattr(one, name) for name in names)


def _eq(values: Callable[[Any], tuple[Any, ...]]) -> Callable[[Any, object], bool]:
    """Returns `__eq__` of a class by the values that are compared, as a tuple: what is the same object is equal."""

    def __eq__(self: Any, other: object) -> bool:
        return values(self) == values(other) if type(other) is type(self) else NotImplemented

    return __eq__


def _hash(values: Callable[[Any], tuple[Any, ...]]) -> Callable[[Any], int]:
    """Returns `__hash__` of a class by the values that are compared."""

    def __hash__(self: Any) -> int:
        return hash(values(self))

    return __hash__


def _is_fixed(self: object, name: str) -> bool:
    """Returns whether an attribute must not change: a field, or any of a dataclass; what is derived may have more."""
    return "__dataclass_fields__" in vars(type(self)) or name in self.__dataclass_fields__  # type: ignore[attr-defined]


def _set_attribute(self: object, name: str, value: object) -> None:
    if _is_fixed(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
    object.__setattr__(self, name, value)


def _delete_attribute(self: object, name: str) -> None:
    if _is_fixed(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
    object.__delattr__(self, name)
