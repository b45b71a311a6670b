"""Dataclasses of this package against those of the standard library, made of the same classes."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from functools import cached_property
from typing import Any, get_type_hints

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
def test_fields_and_signature(dataclass: Decorator) -> None:
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
def test_values_and_defaults(dataclass: Decorator) -> None:
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
def test_classes_that_differ_in_names_alone_keep_their_own(dataclass: Decorator) -> None:
    """Both have two fields and one default; one has a method that is called, and names that mean something else."""

    @dataclass(frozen=True)
    class Way:
        length: float
        name: str = "_0"

    @dataclass(frozen=True)
    class Turn:
        _1: int
        _0: str = "right"

    @dataclass(frozen=True)
    class Called:
        self: int
        other: list[int]

        def __post_init__(self) -> None:
            self.other.append(self.self)

    way, turn, called = Way(2.0), Turn(1), Called(3, [])
    assert (way.length, way.name, turn._0, turn._1) == (2.0, "_0", "right", 1)
    assert (called.self, called.other) == (3, [3])
    assert Turn(_0="left", _1=2) == Turn(2, "left")
    assert inspect.signature(Way).parameters["name"].default == "_0"
    assert get_type_hints(Way.__init__) == {"length": float, "name": str, "return": type(None)}
    for made in (Way, Turn):
        assert made.__init__.__qualname__.endswith(f"{made.__name__}.__init__")
    with pytest.raises(TypeError, match="missing 1 required positional argument: '_1'"):
        Turn()
    with pytest.raises(TypeError, match="unexpected keyword argument 'length'"):
        Turn(1, length=2.0)


@KINDS
@pytest.mark.parametrize("inherited", [False, True])
def test_a_field_without_default_after_one_with_a_default_is_refused(
    dataclass: Decorator, inherited: bool
) -> None:
    @dataclass(frozen=True)
    class Base:
        a: int = 1

    class Own:
        a: int = 1
        b: str

    class Derived(Base):
        b: str

    with pytest.raises(TypeError, match="non-default argument 'b' follows default argument"):
        dataclass(frozen=True)(Derived if inherited else Own)


@KINDS
def test_equality_and_hashes(dataclass: Decorator) -> None:
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
def test_nothing_can_be_set_or_deleted(dataclass: Decorator) -> None:
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


@KINDS
def test_more_attributes_of_a_plain_class_derived_from_it_can_be_set(dataclass: Decorator) -> None:
    class Plain(pair(dataclass)[0]):
        """No dataclass."""

    one = Plain(1)
    one.new = 2
    del one.new
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.a = 2


@KINDS
def test_what_a_class_does_itself_stays(dataclass: Decorator) -> None:
    @dataclass(frozen=True)
    class Own:
        """One that says itself how it is shown, and what it equals."""

        self: int
        _set: dataclasses.InitVar[int] = 3
        kept: int = dataclasses.field(default=4, kw_only=True, hash=False)

        def __repr__(self) -> str:
            return "own"

        def __eq__(self, other: object) -> bool:
            return True

        def __hash__(self) -> int:
            return 7

        def __post_init__(self, _set: int) -> None:
            object.__setattr__(self, "kept", self.kept + _set)

    one = Own(1, 5, kept=2)
    assert (repr(one), one == 2, hash(one), one.kept, one.self) == ("own", True, 7, 7, 1)


@KINDS
def test_names_of_fields_are_free(dataclass: Decorator) -> None:
    @dataclass(frozen=True)
    class Odd:
        """Names that code which makes methods could use itself."""

        self: int
        known: int = 1
        _missing: list[int] = dataclasses.field(default_factory=list)

    assert dataclasses.astuple(Odd(3)) == (3, 1, [])
    assert str(inspect.signature(Odd)).endswith("_missing: 'list[int]' = <factory>) -> None")
    assert get_type_hints(Odd.__init__)["known"] is int
    assert Odd.__dataclass_params__.eq and Odd.__dataclass_params__.frozen


@records.dataclass(frozen=True)
class Sent:
    """What goes to another process."""

    value: object
    inner: Sent | None = None


def test_it_is_pickled() -> None:
    sent = Sent([1.5], Sent("x"))
    assert pickle.loads(pickle.dumps(sent)) == sent


def test_one_within_itself_is_shown() -> None:
    loop: list[object] = []
    sent = Sent(loop)
    loop.append(sent)
    assert repr(sent) == "Sent(value=[...], inner=None)"


@KINDS
def test_a_class_that_is_not_frozen_can_be_changed(dataclass: Decorator) -> None:
    @dataclass
    class Counter:
        """One that is not frozen."""

        count: int = 0

    one = Counter()
    one.count += 1
    assert one == Counter(1)
