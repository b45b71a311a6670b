"""Dataclasses of this package against those of the standard library, made of the same classes."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from functools import cached_property
from typing import Any

import pytest

from dualarm_cli import records

KINDS = pytest.mark.parametrize("dataclass", [records.dataclass, dataclasses.dataclass])
"""Each test holds for both."""
Decorator = Callable[..., Any]


def pair(dataclass: Decorator) -> tuple[type, type]:
    """Returns a class and one derived from it, with every kind of field."""

    @dataclass(frozen=True)
    class First:
        """The first one."""

        a: int
        b: list[int] = dataclasses.field(default_factory=list)
        c: str = dataclasses.field(default="c", compare=False)
        d: float = dataclasses.field(default=2.5, repr=False)
        _e: list[int] = dataclasses.field(init=False, default_factory=lambda: [7])

        @cached_property
        def sum(self) -> float:
            """Something that is kept."""
            return self.a + self.d

    @dataclass(frozen=True)
    class Second(First):
        """The second one."""

        a: int = 5
        f: tuple[int, ...] = (1, 2)
        g: int = dataclasses.field(init=False, repr=False, compare=False)

        def __post_init__(self) -> None:
            object.__setattr__(self, "g", self.a + len(self.b))

    return First, Second


@KINDS
def test_what_it_is_made_of(dataclass: Decorator) -> None:
    first, second = pair(dataclass)
    assert [(f.name, f.init, f.compare) for f in dataclasses.fields(second)] == [
        ("a", True, True),
        ("b", True, True),
        ("c", True, False),
        ("d", True, True),
        ("_e", False, True),
        ("f", True, True),
        ("g", False, False),
    ]
    names = inspect.signature(first).parameters.values()
    assert [(one.name, one.annotation) for one in names] == [
        *[("a", "int"), ("b", "list[int]"), ("c", "str"), ("d", "float")],
    ]
    assert first.__match_args__ == ("a", "b", "c", "d")
    with pytest.raises(TypeError, match=r"__init__\(\) missing 1 required positional argument"):
        first()
    with pytest.raises(TypeError, match="unexpected keyword argument 'x'"):
        second(x=1)


@KINDS
def test_what_it_holds(dataclass: Decorator) -> None:
    first, second = pair(dataclass)
    one, other = first(1), second(b=[3], d=1.0)
    assert (one.a, one.b, one.c, one.d, one._e) == (1, [], "c", 2.5, [7])
    assert (other.a, other.b, other.f, other.g) == (5, [3], (1, 2), 6)
    assert first(1).b is not one.b
    assert repr(one).endswith("First(a=1, b=[], c='c', _e=[7])")
    assert dataclasses.asdict(one) == {"a": 1, "b": [], "c": "c", "d": 2.5, "_e": [7]}
    changed = dataclasses.replace(other, a=2)
    assert (changed.a, changed.b, changed.g) == (2, [3], 3)
    assert (one.sum, copy.deepcopy(one).sum) == (3.5, 3.5)


@KINDS
def test_what_is_equal(dataclass: Decorator) -> None:
    first, second = pair(dataclass)
    assert first(1, c="x") == first(1, c="y") != first(1, d=3.0)
    assert second(1) != first(1)
    assert first(1) != 1

    @dataclass(frozen=True)
    class Named:
        """One that can be a key."""

        name: str

    assert {Named("a"), Named("a"), Named("b")} == {Named("b"), Named("a")}
    assert hash(Named("a")) == hash(("a",))
    with pytest.raises(TypeError, match="unhashable"):
        hash(first(1))

    @dataclass(frozen=True, eq=False)
    class Itself:
        """One that equals itself only."""

        name: str

    assert Itself("a") != Itself("a")
    assert len({Itself("a"), Itself("a")}) == 2


@KINDS
def test_it_is_frozen(dataclass: Decorator) -> None:
    one = pair(dataclass)[1](1)
    for change in (
        lambda: setattr(one, "a", 2),
        lambda: setattr(one, "new", 2),
        lambda: delattr(one, "a"),
    ):
        with pytest.raises(dataclasses.FrozenInstanceError, match=r"cannot (assign|delete)"):
            change()
    assert one.a == 1


@KINDS
@pytest.mark.parametrize("base", [records.dataclass, dataclasses.dataclass])
def test_what_derives_from_it_is_frozen_as_well(dataclass: Decorator, base: Decorator) -> None:
    @base(frozen=True)
    class Base:
        """The first one."""

        a: int

    @dataclass(frozen=True)
    class Derived(Base):
        """One made by either."""

        b: int = 2

    with pytest.raises(dataclasses.FrozenInstanceError):
        Derived(1).b = 3
    with pytest.raises(TypeError, match="cannot inherit non-frozen dataclass from a frozen one"):

        @dataclass
        class Changing(Base):
            """One that could be changed."""


@records.dataclass(frozen=True)
class Sent:
    """What goes to another process."""

    value: object
    inner: Sent | None = None


def test_it_travels() -> None:
    sent = Sent([1.5], Sent("x"))
    assert pickle.loads(pickle.dumps(sent)) == sent


def test_one_within_itself_is_shown() -> None:
    loop: list[object] = []
    sent = Sent(loop)
    loop.append(sent)
    assert repr(sent) == "Sent(value=[...], inner=None)"


@KINDS
def test_others_change(dataclass: Decorator) -> None:
    @dataclass
    class Counter:
        """One that is not frozen."""

        count: int = 0

    one = Counter()
    one.count += 1
    assert one == Counter(1)
