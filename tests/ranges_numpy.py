"""Ranges and jets in numpy, as `compiled/src/postures.c` has them: a middle and a radius, and two derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.postures.platform_reach import AngleCells


@dataclass(frozen=True)
class Range:
    """All numbers within a radius of a middle; arrays of one shape."""

    middle: FloatArray
    """Their middle."""
    radius: FloatArray
    """Not finite where nothing is known."""

    @classmethod
    def of(cls, value: ArrayLike) -> Range:
        """Returns numbers."""
        middle = np.asarray(value, dtype=np.float64)
        return cls(middle, np.zeros_like(middle))

    @classmethod
    def between(cls, low: FloatArray, high: FloatArray) -> Range:
        """Returns all numbers from low to high."""
        with np.errstate(invalid="ignore"):
            return cls(0.5 * (low + high), 0.5 * (high - low))

    @classmethod
    def stacked(cls, rows: list[Range], shape: tuple[int, ...]) -> Range:
        """Returns ranges, each broadcast to a shape, as one."""
        return cls(
            *(
                np.stack([np.broadcast_to(getattr(row, name), shape) for row in rows])
                for name in ("middle", "radius")
            )
        )

    def column(self) -> Range:
        """Returns the same with an axis more."""
        return Range(self.middle[..., None], self.radius[..., None])

    def most(self) -> FloatArray:
        """Returns the largest size."""
        return np.abs(self.middle) + self.radius

    def scaled(self, factor: float) -> Range:
        """Returns it times a number."""
        return Range(factor * self.middle, abs(factor) * self.radius)

    def __add__(self, other: Range) -> Range:
        """Returns all sums."""
        return Range(self.middle + other.middle, self.radius + other.radius)

    def __mul__(self, other: Range) -> Range:
        """Returns all products."""
        with np.errstate(invalid="ignore", over="ignore"):
            radius = np.abs(self.middle) * other.radius + self.radius * other.most()
            return Range(self.middle * other.middle, radius)

    def square(self) -> Range:
        """Returns all squares."""
        least = np.maximum(np.abs(self.middle) - self.radius, 0.0)
        return Range.between(least**2, self.most() ** 2)

    def complement(self) -> Range:
        """Returns one less it."""
        return Range.of(1.0) + self.scaled(-1.0)

    def inverse(self) -> Range:
        """Returns all reciprocals; nothing where zero is among the numbers."""
        low, high = self.middle - self.radius, self.middle + self.radius
        known = (low > 0.0) | (high < 0.0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found = Range.between(1.0 / high, 1.0 / low)
        return Range(np.where(known, found.middle, 0.0), np.where(known, found.radius, np.inf))

    def root(self) -> Range:
        """Returns all square roots of what is not negative; nothing where nothing is known."""
        with np.errstate(invalid="ignore"):
            low, high = self.middle - self.radius, self.middle + self.radius
        known = np.isfinite(self.middle) & np.isfinite(self.radius)
        low, high = (np.sqrt(np.where(known, np.maximum(x, 0.0), 0.0)) for x in (low, high))
        found = Range.between(low, high)
        return Range(found.middle, np.where(known, found.radius, np.inf))

    def narrower(self, other: Range) -> Range:
        """Returns where this one is narrower it, else the other."""
        own = self.radius < other.radius
        return Range(
            np.where(own, self.middle, other.middle), np.where(own, self.radius, other.radius)
        )

    def hull(self, other: Range) -> Range:
        """Returns the least range around both."""
        return Range.between(
            np.minimum(self.middle - self.radius, other.middle - other.radius),
            np.maximum(self.middle + self.radius, other.middle + other.radius),
        )


@dataclass(frozen=True)
class Jet:
    """A function of the platform angle over intervals of it."""

    value: Range
    first: Range
    """First derivative."""
    second: Range
    """Second derivative."""

    @classmethod
    def of(cls, value: ArrayLike) -> Jet:
        """Returns a constant."""
        return cls(Range.of(value), Range.of(0.0), Range.of(0.0))

    def scaled(self, factor: float) -> Jet:
        """Returns it times a number."""
        return Jet(*(x.scaled(factor) for x in (self.value, self.first, self.second)))

    def __add__(self, other: Jet) -> Jet:
        """Returns the sum."""
        return Jet(self.value + other.value, self.first + other.first, self.second + other.second)

    def __mul__(self, other: Jet) -> Jet:
        """Returns the product."""
        second = self.second * other.value + self.value * other.second
        return Jet(
            self.value * other.value,
            self.first * other.value + self.value * other.first,
            second + (self.first * other.first).scaled(2.0),
        )

    def inverse(self) -> Jet:
        """Returns the reciprocal."""
        one = self.value.inverse()
        two = one * one
        bent = (self.first.square() * (two * one)).scaled(2.0)
        return Jet(one, (self.first * two).scaled(-1.0), bent + (self.second * two).scaled(-1.0))

    def root(self) -> Jet:
        """Returns the square root."""
        value = self.value.root()
        half = value.inverse().scaled(0.5)
        bent = self.first.square() * (half * half.square())
        return Jet(value, self.first * half, self.second * half + bent.scaled(-2.0))


def middle(intervals: AngleCells) -> FloatArray:
    """Returns the middles of intervals [rad], shape (c,)."""
    return 0.5 * (intervals.low + intervals.high)


def half(intervals: AngleCells) -> FloatArray:
    """Returns half the widths of intervals [rad], shape (c,)."""
    return 0.5 * (intervals.high - intervals.low)


def turning(intervals: AngleCells, constant: ArrayLike, p: ArrayLike, q: ArrayLike) -> Jet:
    """Returns constant + p cos(phi) + q sin(phi) over intervals of the platform angle."""
    c, s, h = np.cos(middle(intervals)), np.sin(middle(intervals)), half(intervals)
    value, slope = p * c + q * s, q * c - p * s
    bent = 0.5 * np.hypot(p, q) * h**2
    steep, high = np.abs(slope) * h + bent, np.abs(value) * h + bent
    return Jet(Range(constant + value, steep), Range(slope, high), Range(-value, steep))


def seen(
    intervals: AngleCells, standing: FloatArray, turns: FloatArray, constant: ArrayLike
) -> Jet:
    """Returns a constant plus the component of a vector that stands (..., 3) along one that turns (3,)."""
    x, y, z = (standing[..., i] for i in range(3))
    p, q = x * turns[0] + y * turns[1], y * turns[0] - x * turns[1]
    return turning(intervals, z * turns[2] + constant, p, q)
