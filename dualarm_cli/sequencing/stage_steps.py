"""From stage to stage where an arm was idle: with where it really comes from, which a graph of stages forgets."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.sequencing.stage_graph import StageGraph, followers, task_of
from dualarm_cli.sequencing.stage_problem import IDLE


class StageSteps:
    """Lengths and rules of steps whose arms' last stops are known; the number of stops stands for the start."""

    def __init__(self, graph: StageGraph) -> None:
        """Keeps what rules ask of each stop."""
        self.graph, problem = graph, graph.problem
        after, before = followers(problem)
        # The last entry is both the start's and that of nothing to do.
        self._after, self._before = np.append(after, IDLE), np.append(before, IDLE)
        self._task = np.append(task_of(problem), -1)

    def came(self, node: IntArray, idle: IntArray) -> IntArray:
        """Returns each arm's last stop after stages, shape (n, 2).

        Args:
            node: the stages, shape (n,).
            idle: the last stop of the arm that is idle in them, anything where none is, shape (n,).
        """
        stops = self.graph.stops[node]
        return np.where(stops == IDLE, idle[:, None], stops)

    def idle(self, came: IntArray, node: IntArray) -> IntArray:
        """Returns the last stop of the arm that is idle in stages, IDLE where none is, shape (n,).

        Args:
            came: each arm's last stop before them, shape (n, 2).
            node: the stages, shape (n,).
        """
        rests = self.graph.stops[node] == IDLE
        return np.where(rests.any(axis=1), np.where(rests, came, 0).sum(axis=1), IDLE)

    def lengths(self, came: IntArray, angle: IntArray, node: IntArray) -> FloatArray:
        """Returns how long stages take after what each arm did last [s], infinite where rules forbid them, shape (n,).

        Args:
            came: each arm's last stop before them, shape (n, 2).
            angle: number of the platform angle before them, shape (n,).
            node: the stages, shape (n,).
        """
        problem, stops, then = self.graph.problem, self.graph.stops[node], self.graph.angle[node]
        ways = [
            length[came[:, a], stops[:, a], angle, then] for a, length in enumerate(problem.length)
        ]
        found = np.maximum(ways[0], ways[1]).astype(np.float64)
        if problem.apart is not None:
            found += problem.apart[stops[:, 0], stops[:, 1], then]
        due, needs = self._after[came], self._before[stops]
        wrong = (due != IDLE) & (stops != due) & (stops != IDLE)
        wrong |= (needs != IDLE) & (came != needs)
        if problem.in_file_order:
            wrong |= (stops != IDLE) & (self._task[stops] < self._task[came])
        found[wrong.any(axis=1)] = np.inf
        return found

    def way_back(self, node: IntArray, idle: IntArray) -> FloatArray:
        """Returns how long the way back takes after stages [s], shape (n,); arguments as of `came`."""
        problem, found = self.graph.problem, np.array(self.graph.last[node])
        if not problem.returns:
            return found
        stops, angle = self.graph.stops[node], self.graph.angle[node]
        for a, length in enumerate(problem.length):
            rests = (stops[:, a] == IDLE) & (idle != problem.stops)
            back = length[idle[rests], problem.stops, angle[rests], 0]
            found[rests] = np.maximum(found[rests], back)
        return found
