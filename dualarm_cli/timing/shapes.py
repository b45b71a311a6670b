"""Normalised double-S shapes of motion along a path, and polynomials through path samples."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.elementary import cube
from dualarm_cli.geometry.products import product
from dualarm_cli.records import dataclass


def lagrange_basis(nodes: FloatArray, x: FloatArray) -> FloatArray:
    """Evaluate the Lagrange polynomials of m nodes at k points, shape (k, m).

    Each is the product of all other gaps x - node, multiplied from both sides without division by a gap, so that
    points on nodes need no special case.
    """
    basis: FloatArray = _products_of_others(nodes, x) / _products_of_gaps(nodes)
    return basis


def _products_of_others(nodes: FloatArray, x: FloatArray) -> FloatArray:
    """Compute for each node the product of x minus every other node, shape (k, m)."""
    gap = x[:, None] - nodes
    before, after = np.ones_like(gap), np.ones_like(gap)
    np.cumprod(gap[:, :-1], axis=1, out=before[:, 1:])
    np.cumprod(gap[:, :0:-1], axis=1, out=after[:, -2::-1])
    before *= after
    return before


def _products_of_gaps(nodes: FloatArray) -> FloatArray:
    """Compute for each node the product of its distances to the others, shape (m,)."""
    products: FloatArray = (nodes[:, None] - nodes + np.eye(len(nodes))).prod(axis=1)
    return products


def differentiation_matrix(nodes: FloatArray) -> FloatArray:
    """Build the matrix from values at m nodes to the derivative there, (m, m)."""
    weight = _products_of_gaps(nodes)
    D: FloatArray = weight[:, None] / (weight * (nodes[:, None] - nodes + np.eye(len(nodes))))
    np.fill_diagonal(D, 0.0)
    # A constant has no derivative.
    np.fill_diagonal(D, -D.sum(axis=1))
    return D


@dataclass(frozen=True)
class Shapes:
    """Double-S shapes, g of them; each has its own start and end ramp.

    A ramp takes a share of the time, and its two jerk phases take shares of the ramp; together 1: no phase of
    constant acceleration. Between the ramps the speed is constant.
    """

    start: FloatArray
    """Fraction of the time in which the speed rises, shape (g,)."""
    start_jerk: FloatArray
    """Fraction of the start ramp in which the acceleration rises, shape (g,)."""
    start_inner: FloatArray
    """Fraction of the start ramp in which the acceleration falls, shape (g,)."""
    end: FloatArray
    """Fraction of the time in which the speed falls, shape (g,).

    start + end <= 1.
    """
    end_jerk: FloatArray
    """Fraction of the end ramp in which the deceleration falls, shape (g,)."""
    end_inner: FloatArray
    """Fraction of the end ramp in which the deceleration rises, shape (g,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for field in fields(self):
            object.__setattr__(self, field.name, readonly(getattr(self, field.name)))

    def breakpoints(self) -> FloatArray:
        """Compute the eight borders of the seven phases, shape (g, 8)."""
        r1, r2, edges = self.start, self.end, np.zeros((len(self.start), 8))
        edges[:, 1], edges[:, 2], edges[:, 3] = r1 * self.start_jerk, r1 - r1 * self.start_inner, r1
        edges[:, 4], edges[:, 5] = 1.0 - r2, 1.0 - r2 + r2 * self.end_inner
        edges[:, 6], edges[:, 7] = 1.0 - r2 * self.end_jerk, 1.0
        return edges

    def phases(self) -> FloatArray:
        """Compute progress, speed, acceleration and jerk at phase starts, shape (4, g, 7).

        A ramp of length r with jerk phases of lengths x and y rises to the speed 1 with the acceleration
        a = 1 / (r - (x + y)/2). The phases are integrated, and scaled to a distance of 1.
        """
        r1, r2 = self.start, self.end
        x1, y1 = r1 * self.start_jerk, r1 * self.start_inner
        x2, y2 = r2 * self.end_jerk, r2 * self.end_inner
        a1, a2 = 1.0 / (r1 - (x1 + y1) / 2.0), 1.0 / (r2 - (x2 + y2) / 2.0)
        jerk = np.zeros((7, len(r1)))
        jerk[0], jerk[2], jerk[4], jerk[6] = a1 / x1, -a1 / y1, -a2 / y2, a2 / x2
        state = np.zeros((4, len(r1), 7))
        at = np.zeros((3, len(r1)))
        for phase, length in enumerate(np.diff(self.breakpoints()).T):
            state[:, :, phase] = *at, jerk[phase]
            at = np.array(_advance(state[:, :, phase], length)[:3])
        return state / at[0][:, None]

    def within_phases(
        self, per_phase: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Evaluate progress, speed, acceleration and jerk in every phase, each (g, 7 k).

        Ends of phases are included, so that both limits of a jump of jerk are present.

        Args:
            per_phase: number k of equidistant instants per phase.
        """
        edges = self.breakpoints()
        dt = (edges[:, 1:] - edges[:, :-1])[:, :, None] * np.linspace(0.0, 1.0, per_phase)
        g = len(dt)
        progress, speed, acceleration, jerk = _advance(self.phases()[..., None], dt)
        return (
            progress.reshape(g, -1),
            speed.reshape(g, -1),
            acceleration.reshape(g, -1),
            np.repeat(jerk[..., 0], per_phase, axis=1),
        )

    def path_rates(
        self, per_phase: int, nodes: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Build matrices from path samples to three derivatives in unit time.

        Args:
            per_phase: number of instants per phase, as of `within_phases`; rows are all instants of all shapes.
            nodes: fractions of the path at which it is sampled, shape (m,).
        """
        s, sd, sdd, sddd = (values.ravel() for values in self.within_phases(per_phase))
        D = differentiation_matrix(nodes)
        at = lagrange_basis(nodes, s)
        first, second, third = product(at, D), product(at, D, D), product(at, D, D, D)
        sd, sdd, sddd = sd[:, None], sdd[:, None], sddd[:, None]
        return (
            sd * first,
            sdd * first + np.square(sd) * second,
            sddd * first + 3.0 * sd * sdd * second + cube(sd) * third,
        )


def _advance(
    state: FloatArray, dt: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Integrate states (4, ...) over dt of constant jerk."""
    s, v, a, j = state
    return (
        s + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
        v + dt * (a + dt * j / 2.0),
        a + dt * j,
        j,
    )


def symmetric_grid(ramps: FloatArray, jerks: FloatArray, inner: float = 1.0) -> Shapes:
    """Build all symmetric shapes of given ramp fractions (at most 0.5) and jerk fractions.

    The inner jerk phases are longer than the outer ones by the factor `inner`; both together have the mean length.
    """
    ramp, jerk = (grid.ravel() for grid in np.meshgrid(ramps, jerks, indexing="ij"))
    outer = jerk * (2.0 / (1.0 + inner))
    return Shapes(ramp, outer, outer * inner, ramp, outer, outer * inner)
