"""Dataclasses that load quickly: as those of `dataclasses`, whose decorator compiles six functions for a frozen class.

With some 400 classes these are a third of the time in which the package loads. Here one function of each class is
compiled, its `__init__`, and all classes share the others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

T = TypeVar("T")

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, eq=True):
        """Makes a class a dataclass, as `dataclasses.dataclass` does with the same arguments."""
        if cls is None:
            return lambda made: dataclass(made, frozen=frozen, eq=eq)
        if not frozen:
            return dataclasses.dataclass(cls, eq=eq)
        return _frozen(cls, eq)


def _frozen(cls: type[T], eq: bool) -> type[T]:
    """Returns a class as a frozen dataclass."""
    own = vars(cls).get
    # Asked for a frozen class it compiles two functions, which are shared here; derived classes have to be asked for.
    derived = any(dataclasses.is_dataclass(base) for base in cls.__mro__[1:])
    made = dataclasses.dataclass(init=False, repr=False, eq=False, frozen=derived)(cls)
    made.__dataclass_params__.frozen = True  # type: ignore[attr-defined]
    fields = dataclasses.fields(made)  # type: ignore[arg-type]
    added: dict[str, Any] = {
        "__init__": _init(made, fields),
        "__repr__": own("__repr__") or _repr([f.name for f in fields if f.repr]),
        "__setattr__": _no_assignment,
        "__delattr__": _no_deletion,
    }
    if eq:
        values = _values([f.name for f in fields if f.compare])
        added["__eq__"], added["__hash__"] = _eq(values), lambda one: hash(values(one))
    for name, function in added.items():
        setattr(made, name, function)
    return made


def _init(cls: type, fields: Sequence[dataclasses.Field[Any]]) -> Callable[..., None]:
    """Returns `__init__` of a class, which sets its fields, and calls `__post_init__` if there is one."""
    known: dict[str, Any] = {"_set": object.__setattr__, "_missing": dataclasses.MISSING}
    arguments, lines = ["self"], []
    for field in fields:
        name = value = argument = field.name
        is_made = field.default_factory is not dataclasses.MISSING
        if is_made:
            known[f"_of_{name}"] = field.default_factory
            argument = f"{name}=_missing"
            value = f"_of_{name}() if {name} is _missing else {name}"
        elif field.default is not dataclasses.MISSING:
            known[f"_of_{name}"] = field.default
            argument = f"{name}=_of_{name}"
        if field.init:
            arguments.append(argument)
            lines.append(f" _set(self, {name!r}, {value})")
        elif is_made:
            lines.append(f" _set(self, {name!r}, _of_{name}())")
    if hasattr(cls, "__post_init__"):
        lines.append(" self.__post_init__()")
    exec(f"def __init__({', '.join(arguments)}):\n" + ("\n".join(lines) or " pass"), known)
    made: Callable[..., None] = known["__init__"]
    made.__qualname__, made.__module__ = f"{cls.__qualname__}.__init__", cls.__module__
    made.__annotations__ = {f.name: f.type for f in fields if f.init} | {"return": None}
    return made


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
    """Returns `__eq__` of a class by the values that are compared."""

    def __eq__(self: Any, other: object) -> bool:
        return values(self) == values(other) if type(other) is type(self) else NotImplemented

    return __eq__


def _no_assignment(self: object, name: str, value: object) -> NoReturn:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _no_deletion(self: object, name: str) -> NoReturn:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
