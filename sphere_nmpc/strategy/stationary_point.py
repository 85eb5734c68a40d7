# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Detection of stationary points short of the goal, and initial guesses that lead away from them.

From upright rest with the goal straight ahead, or with a wrong heading alone, the gradient has no
component across the plane of symmetry: a descent from rest stays in that plane and converges to
a saddle point of the cost. Step 1 of Algorithm 1 leaves the initial guess open, so where the
horizon has moved on by a sample period and its end is no nearer to the goal, the problem is solved
from guesses without that symmetry, too.
"""

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution

SETTLED_COST = 1e-4
"""Cost of a plan that ends within 1e-2 of the goal, the error at which a run counts as settled."""

_LEAST_DECREASE = 1e-3
"""Relative decrease of the cost in a sample period below which the point counts as stationary. A
goal straight ahead exceeds it up to 700 m away; a wrong value only costs or saves a few solves."""

_AMPLITUDE = 0.3
"""Amplitude of the guesses [of the speed limit]. From stationary points of all kinds, guesses of
0.3 and 0.7 and random ones led to the same least costs."""

NO_PROGRESS = "stationary point: no initial guess leads nearer to the goal"
"""What a plan says that none of the guesses has improved."""


def loops(problem: HoldProblem) -> list[Vector]:
    """Return initial guesses in which the rotor speeds run through a loop, a quarter a knot.

    The loops have both directions and start along either rotor's axis, in either sense: none is
    its own mirror image, and the bracket of the two inputs turns the sphere about its third axis.

    Returns
    -------
    list of ndarray, shape (N, 2) [rad/s]
    """
    quarters = 0.5 * np.pi * np.arange(1, problem.intervals + 1)
    guesses = []
    for begin in (0.25 * np.pi, 1.25 * np.pi):
        for direction in (1.0, -1.0):
            angles = begin + direction * quarters
            loop = np.column_stack((np.cos(angles), np.sin(angles)))
            guesses.append(problem.input_reference + _AMPLITUDE * problem.input_scale * loop)
    return guesses


class Descent:
    """Decrease of the cost from one sample period to the next.

    Parameters
    ----------
    settled_cost : float
        Cost [squared error] up to which a plan counts as reaching the goal.
    """

    def __init__(self, settled_cost: float) -> None:
        self._settled_cost = settled_cost
        self._horizon_end = -np.inf
        self._last_cost = np.inf

    def has_ended(self, horizon_end: float, solution: HoldSolution) -> bool:
        """Record a solution and return whether it is a stationary point short of the goal.

        Parameters
        ----------
        horizon_end : float
            End of the horizon [s]; between two knots it stays, and so does the cost.
        solution : HoldSolution
            Solution from the warm start, which is itself stationary where it took no iteration.
        """
        if horizon_end <= self._horizon_end:
            return False
        last, cost = self._last_cost, solution.cost
        self._horizon_end, self._last_cost = horizon_end, cost
        stationary = solution.iterations == 0 or not cost < (1.0 - _LEAST_DECREASE) * last
        return stationary and cost > self._settled_cost
