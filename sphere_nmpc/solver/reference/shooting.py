# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Single shooting: states and sensitivities along a first-order hold, on CasADi's VM."""

import numpy as np

from sphere_nmpc.model.integrator import steps_for, tangent_step_function
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.solver.problem import HoldProblem

DIRECTIONS = 8
"""Derivative directions of one interval: its quaternion (4) and its two knots (2 + 2)."""


def roll_out(problem: HoldProblem, inputs: Vector) -> Vector:
    """Return the states at the knots, shape (N + 1, 6), under knots `inputs`, shape (N + 1, 2)."""
    # With no directions the same function is a step without sensitivities.
    return _shoot(problem, inputs, 0)[0]


def roll_out_with_sensitivity(problem: HoldProblem, inputs: Vector) -> tuple[Vector, Vector]:
    """Return the states at the knots and their derivatives by the free knots.

    Parameters
    ----------
    problem : HoldProblem
        State, durations and constants are used.
    inputs : ndarray, shape (N + 1, 2)
        Knots u_0 ... u_N [rad/s].

    Returns
    -------
    states : ndarray, shape (N + 1, 6)
    sensitivities : ndarray, shape (N + 1, 6, 2 N)
        d x_m / d (u_1, ..., u_N), per rad/s.
    """
    return _shoot(problem, inputs, DIRECTIONS)


def _shoot(problem: HoldProblem, inputs: Vector, directions: int) -> tuple[Vector, Vector]:
    step = tangent_step_function(directions)
    intervals = problem.intervals
    states = np.empty((intervals + 1, 6))
    states[0] = problem.state
    sensitivities = np.zeros((intervals + 1, 6, 2 * intervals))
    seed = np.eye(DIRECTIONS)[:, :directions]
    for m in range(intervals):
        u_start, u_end = inputs[m], inputs[m + 1]
        steps = steps_for(float(problem.durations[m]), problem.max_step)
        h = float(problem.durations[m]) / steps
        position = states[m, POSITION]
        q = states[m, QUATERNION]
        dq = seed[0:4]
        dxy = np.zeros((2, directions))
        for i in range(steps):
            a, b = i / steps, (i + 1) / steps
            here, there = u_start + (u_end - u_start) * a, u_start + (u_end - u_start) * b
            d_here = (1.0 - a) * seed[4:6] + a * seed[6:8]
            d_there = (1.0 - b) * seed[4:6] + b * seed[6:8]
            out = step(q, here, there, h, problem.constants, dq, d_here, d_there)
            moved, q_end, d_moved, dq_end = (np.array(value) for value in out)
            position = position + moved.ravel()
            q = q_end.ravel()
            dxy, dq = dxy + d_moved, dq_end
        states[m + 1, POSITION], states[m + 1, QUATERNION] = position, q
        if directions:
            before = sensitivities[m]
            sensitivities[m + 1, POSITION] = before[POSITION] + dxy[:, 0:4] @ before[QUATERNION]
            sensitivities[m + 1, QUATERNION] = dq[:, 0:4] @ before[QUATERNION]
            if m > 0:
                sensitivities[m + 1, POSITION, 2 * m - 2 : 2 * m] += dxy[:, 4:6]
                sensitivities[m + 1, QUATERNION, 2 * m - 2 : 2 * m] += dq[:, 4:6]
            sensitivities[m + 1, POSITION, 2 * m : 2 * m + 2] += dxy[:, 6:8]
            sensitivities[m + 1, QUATERNION, 2 * m : 2 * m + 2] += dq[:, 6:8]
    return states, sensitivities
