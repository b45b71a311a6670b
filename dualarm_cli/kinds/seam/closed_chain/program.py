"""Sparse quadratic program of one step to a faster seam, in joints and time."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN, cos, power, sin
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.programs import plain_piqp
from dualarm_cli.kinds.seam.closed_chain.chain import KEPT
from dualarm_cli.kinds.seam.closed_chain.closing import all_equations
from dualarm_cli.kinds.seam.closed_chain.posture_paths import POSTURE_PATHS
from dualarm_cli.kinds.seam.closed_chain.problem import SeamProblem
from dualarm_cli.kinds.seam.closed_chain.starts import part_poses
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class StepSettings:
    """Settings of one quadratic program."""

    smooth: float = 1e-4
    """Weight of the joints' effort against time, both relative.

    It selects among equally fast motions.
    """
    stay: float = 1e-6
    """Weight of the step itself."""
    accuracy: float = 1e-6
    """Tolerances of the solver."""
    most_iterations: int = 60
    """Maximum number of solver iterations. Its result is then used as it is."""
    lean_sides: int = 8
    """Number of sides of the polygon that replaces the cone of tool tilts."""
    back: float = 100.0
    """Weight of a radian beyond limits [fraction of the time]."""
    away: float = 3.0
    """Weight of the used margin to limits, as a fraction, against effort."""
    least_time: float = 0.3
    """Least fraction of its time that a seam keeps in one step."""


STEP = StepSettings()


@dataclass(frozen=True)
class SeamProgram:
    """Quadratic program of one seam with one choice of standing joints."""

    problem: SeamProblem
    """The seam."""
    stands: BoolArray
    """Flags of joints that are constant or without influence, shape (n,).

    They are constant over all nodes.
    """

    @cached_property
    def decided(self) -> IntArray:
        """Columns of the joints that are optimised."""
        return np.flatnonzero(self.problem.chain.closes)

    @cached_property
    def column(self) -> IntArray:
        """Variable of each node's joint, shape (nodes, decided).

        Standing joints have one variable for all nodes.
        """
        standing = self.stands[self.decided]
        shared, moving = int(standing.sum()), int((~standing).sum())
        variables = np.empty((self.problem.nodes, len(self.decided)), dtype=np.int64)
        variables[:, standing] = np.arange(shared)
        variables[:, ~standing] = shared + np.arange(self.problem.nodes * moving).reshape(
            self.problem.nodes, moving
        )
        return variables

    @cached_property
    def _spread(self) -> Any:
        """Matrix from variables to all nodes' decided joints."""
        from scipy.sparse import csr_matrix

        column = self.column.ravel()
        ones = np.ones(len(column))
        return csr_matrix(
            (ones, (np.arange(len(column)), column)), shape=(len(column), column.max() + 1)
        )

    @cached_property
    def _rates(self) -> list[Any]:
        """Matrices from the nodes' joints to relative rates, by order."""
        from scipy.sparse import csr_matrix, diags, kron

        limits, matrices = self.problem.limits, []
        difference = np.eye(self.problem.nodes)
        for limit in (limits.velocity, limits.acceleration, limits.jerk):
            difference = np.diff(difference, axis=0) * (self.problem.nodes - 1)
            bounds = np.where(np.isfinite(limit), limit, 1e12)[self.decided]
            matrices.append(kron(csr_matrix(difference), diags(1.0 / bounds)).tocsr())
        return matrices

    def _effort(self, time: float) -> Any:
        """Assemble the matrix from the nodes' joints to relative rates.

        Their squares add up to means over the nodes.
        """
        from scipy.sparse import vstack

        return vstack([self._rates[0] / time, self._rates[1] / (time * time)]) / np.sqrt(
            self.problem.nodes
        )

    def step(
        self, position: FloatArray, time: float, radius: float, pace: float
    ) -> tuple[FloatArray, float] | None:
        """Solve for joints (nodes, n) and the seam's time; None if the program fails.

        Rates are linear in the joints; their bounds grow with time, time² and time³, which tangents replace from
        below.

        Args:
            position: joints at the nodes, chain closed [rad], shape (nodes, n).
            time: steady time of the seam with them [s].
            radius: trust-region radius of the joints [rad].
            pace: weight of a second of time; 0 for the smoothest motion of the same time.
        """
        from scipy.sparse import block_diag, csr_matrix, diags, hstack, identity

        piqp = plain_piqp()

        S = self._spread
        y = position[:, self.decided].ravel()
        count = S.shape[1]
        G, high, beyond = self._inequalities(position, time)
        A, b = self._equations(position)
        A = hstack([A @ S, csr_matrix((A.shape[0], 2))]).tocsc()
        effort = self._effort(time)
        smooth = effort @ S
        weight = STEP.smooth * time if pace > 0.0 else 1.0
        quadratic = weight * (smooth.T @ smooth) + STEP.stay * identity(count)
        pull = weight * (smooth.T @ (effort @ y))
        if pace == 0.0:
            crowded, slope = self._crowded(y)
            quadratic = quadratic + diags(crowded)
            pull = pull - slope
        P = block_diag([quadratic, 1e-9 * identity(2)]).tocsc()
        c = np.append(pull, [pace, STEP.back * time])
        low, top = self._bounds(y, radius)
        solver = piqp.SparseSolver()
        solver.settings.eps_abs = solver.settings.eps_rel = STEP.accuracy
        solver.settings.max_iter = STEP.most_iterations
        least = (STEP.least_time - 1.0) * time if pace > 0.0 else 0.0
        solver.setup(
            P,
            c,
            A,
            b,
            G,
            np.full(len(high), -np.inf),
            high,
            np.append(low, [least, 0.0]),
            np.append(top, [time if pace > 0.0 else 0.0, beyond]),
        )
        solver.solve()
        x = np.array(solver.result.x)
        if not np.isfinite(x).all():
            return None
        moved = np.array(position)
        moved[:, self.decided] += (S @ x[:-2]).reshape(self.problem.nodes, -1)
        return moved, time + float(x[-2])

    def _inequalities(self, position: FloatArray, time: float) -> tuple[Any, FloatArray, float]:
        """Assemble the rows of the inequalities, their upper bounds, and the largest excess over position limits.

        The columns are the variables, the change of time, and the excess that is still allowed.
        """
        from scipy.sparse import csr_matrix, hstack, vstack

        S, y = self._spread, position[:, self.decided].ravel()
        rows, right = [], []
        for order, rate in enumerate(self._rates, start=1):
            now = rate @ y
            slope = csr_matrix(np.full((len(now), 1), -order * power(time, order - 1)))
            spread = rate @ S
            rows += [hstack([spread, slope]), hstack([-spread, slope])]
            right += [power(time, order) - now, power(time, order) + now]
        for extra, bound in self._freedoms(position):
            rows.append(hstack([extra @ S, csr_matrix((len(bound), 1))]))
            right.append(bound)
        G, high = vstack(rows), np.concatenate(right)
        back, short = self._back_inside(y)
        excess = csr_matrix(-np.ones((len(short), 1)))
        G = vstack(
            [
                hstack([G, csr_matrix((G.shape[0], 1))]),
                hstack([back, csr_matrix((len(short), 1)), excess]),
            ]
        ).tocsc()
        return G, np.append(high, -short), float(short.max(initial=0.0))

    def _equations(self, position: FloatArray) -> tuple[Any, FloatArray]:
        """Linearise the chain's equations in the nodes' joints."""
        from scipy.sparse import block_diag

        problem = self.problem
        chain, share = problem.chain, problem.shares
        seam = chain.equations(chain.bodies(position), share).exact
        blocks = list(seam.slope[:, :, self.decided])
        residuals = list(seam.residuals)
        poses = part_poses(problem, share)
        if poses is not None:
            part = all_equations(chain, position, share, part=poses)
            # A standing part has its pose at every node if it has it at one.
            nodes = 1 if chain.work.hold.stands else problem.nodes
            for k in range(nodes):
                blocks[k] = np.concatenate([part.slope[k, :6][:, self.decided], blocks[k]])
                residuals[k] = np.concatenate([part.residuals[k, :6], residuals[k]])
        return block_diag(blocks).tocsr(), -np.concatenate(residuals)

    def _freedoms(self, position: FloatArray) -> list[tuple[Any, FloatArray]]:
        """Linearise the inequalities on tilts of the tool's axis and of the surface.

        Tilts within the cone but beyond the polygon may stay: a step must be possible.
        """
        from scipy.sparse import block_diag

        problem = self.problem
        chain, work, share = problem.chain, problem.chain.work, problem.shares
        constraints = []
        bodies = chain.bodies(position)
        if work.tool.tilt > 0.0:
            r, J = chain.offsets(bodies, share)
            angle = np.arange(STEP.lean_sides) * (TURN / STEP.lean_sides)
            sides = np.stack([cos(angle), sin(angle)], axis=-1)
            slope = product(sides, J[:, 3:5][:, :, self.decided])
            bound = KEPT * work.tool.tilt * cos(np.pi / STEP.lean_sides) - product(
                r[:, 3:5], sides.T
            )
            constraints.append((block_diag(list(slope)).tocsr(), np.maximum(bound, 0.0).ravel()))
        if work.downhand is not None:
            upward, J = chain.upward(bodies, share)
            slope = -J[:, None, self.decided]
            constraints.append(
                (
                    block_diag(list(slope)).tocsr(),
                    np.maximum(upward - cos(KEPT * work.downhand), 0.0),
                )
            )
        return constraints

    def unease(self, position: FloatArray, time: float) -> float:
        """Compute a motion's cost for its time: effort, and use of limit margins.

        Args:
            position: joints at the nodes [rad], shape (nodes, n).
            time: steady time of the seam [s].
        """
        y = position[:, self.decided].ravel()
        near, effort = self._near(y), self._effort(time) @ y
        return (
            float(product(effort, effort) + STEP.away / self.problem.nodes * product(near, near))
            / 2.0
        )

    @cached_property
    def _room(self) -> FloatArray:
        """Preferred margin to each limit, for all nodes' joints [rad]."""
        low, high = (
            np.tile(bound[self.decided], self.problem.nodes) for bound in self.problem.bounds
        )
        margins: FloatArray = POSTURE_PATHS.room * (high - low)
        return margins

    def _near(self, y: FloatArray) -> FloatArray:
        """Compute the used fraction of that margin for all nodes' joints.

        It is positive at the lower limit.
        """
        low, high = (
            np.tile(bound[self.decided], self.problem.nodes) for bound in self.problem.bounds
        )
        room = self._room
        used: FloatArray = np.maximum(low + room - y, 0.0) - np.maximum(y - high + room, 0.0)
        return used / room

    def _crowded(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute curvature and slope of the cost of used margins, by variable."""
        near, room = self._near(y), self._room
        column, count = self.column.ravel(), self._spread.shape[1]
        crowded, away = np.zeros(count), np.zeros(count)
        np.add.at(crowded, column, STEP.away / self.problem.nodes * (near != 0.0) / np.square(room))
        np.add.at(away, column, STEP.away / self.problem.nodes * near / room)
        return crowded, away

    def _back_inside(self, y: FloatArray) -> tuple[Any, FloatArray]:
        """Assemble rows that bring variables back inside their bounds, and their excesses [rad]."""
        from scipy.sparse import csr_matrix

        lower, upper = (
            np.tile(bound[self.decided], self.problem.nodes) for bound in self.problem.bounds
        )
        short = np.concatenate([lower - y, y - upper])
        which = np.flatnonzero(short > 0.0)
        column = np.tile(self.column.ravel(), 2)[which]
        sign = np.where(which < len(y), -1.0, 1.0)
        shape = (len(which), self._spread.shape[1])
        return csr_matrix((sign, (np.arange(len(which)), column)), shape=shape), short[which]

    def _bounds(self, y: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
        """Compute least and greatest steps of the variables [rad]."""
        lower, upper = (
            np.tile(bound[self.decided], self.problem.nodes) for bound in self.problem.bounds
        )
        column, count = self.column.ravel(), self._spread.shape[1]
        low, top = np.full(count, -radius), np.full(count, radius)
        if self.problem.begin is not None:
            low[self.column[0]] = top[self.column[0]] = 0.0
        np.maximum.at(low, column, np.minimum(lower - y, 0.0))
        np.minimum.at(top, column, np.maximum(upper - y, 0.0))
        return low, top
