# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Single shooting: states and sensitivities along a first-order hold, on CasADi's VM."""

from collections.abc import Callable

import numpy as np

from sphere_nmpc.model.drift import MOMENTUM
from sphere_nmpc.model.integrator import (
    steps_for,
    tangent_drift_step_function,
    tangent_step_function,
)
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.problem import HoldProblem

Step = Callable[..., tuple[Vector, Vector, Vector, Vector]]
"""Function ``(y, u_start, u_end, h, dy, du_start, du_end) -> (dxy, y_end, ddxy, dy_end)`` of an
integration step; y is the quaternion and, with drift, the momentum (4 or 7 components)."""


def roll_out(problem: HoldProblem, inputs: Vector) -> tuple[Vector, Vector]:
    """Return states (N + 1, 6) at the knots `inputs`, (N + 1, 2), and momentum (3,) at the end."""
    # With no directions the same function is a step without sensitivities.
    found = _shoot(problem, inputs, False)[0]
    return found[:, :6], _momentum(found)


def roll_out_with_sensitivity(
    problem: HoldProblem, inputs: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return states at the knots and the momentum at the end, with derivatives by the free knots.

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
    momentum : ndarray, shape (3,)
        h_N [rad/s; world frame]; zero without drift.
    by_momentum : ndarray, shape (3, 2 N)
        d h_N / d (u_1, ..., u_N).
    """
    found, derivatives = _shoot(problem, inputs, True)
    by_momentum = derivatives[-1, 6:]
    if not len(by_momentum):
        by_momentum = np.zeros((3, 2 * problem.intervals))
    return found[:, :6], derivatives[:, :6], _momentum(found), by_momentum


def _momentum(found: Vector) -> Vector:
    momentum: Vector = found[-1, 6:] if found.shape[1] > 6 else np.zeros(3)
    return momentum


def _shoot(problem: HoldProblem, inputs: Vector, derive: bool) -> tuple[Vector, Vector]:
    drifts = bool(problem.drift.any())
    carried = 7 if drifts else 4
    # Derivative directions of one interval: y at its start and its two knots.
    seed = np.eye(carried + 4) if derive else np.zeros((carried + 4, 0))
    step = (_drift_step if drifts else _plain_step)(problem, seed.shape[1])
    intervals = problem.intervals
    states = np.empty((intervals + 1, 2 + carried))
    states[0, :6] = problem.state
    states[0, 6:] = problem.drift[MOMENTUM][: carried - 4]
    sensitivities = np.zeros((intervals + 1, 2 + carried, 2 * intervals))
    for m in range(intervals):
        u_start, u_end = inputs[m], inputs[m + 1]
        left_out = problem.whole_turns if m == problem.steady_interval else 0.0
        duration = float(problem.durations[m]) - left_out
        steps = steps_for(duration, problem.max_step)
        h = duration / steps
        way: Vector = np.zeros(2)
        y = states[m, 2:]
        dxy: Vector = np.zeros((2, seed.shape[1]))
        dy: Vector = seed[:carried]
        first, second = seed[carried : carried + 2], seed[carried + 2 :]
        for i in range(steps):
            a, b = i / steps, (i + 1) / steps
            here, there = u_start + (u_end - u_start) * a, u_start + (u_end - u_start) * b
            d_here, d_there = (1.0 - a) * first + a * second, (1.0 - b) * first + b * second
            moved, y, d_moved, dy = step(y, here, there, h, dy, d_here, d_there)
            way, dxy = way + moved, dxy + d_moved
        scale = float(problem.durations[m]) / duration
        dxy = scale * dxy
        states[m + 1] = np.concatenate((states[m, :2] + scale * way, y))
        if derive:
            before, local = sensitivities[m], np.vstack((dxy, dy))
            sensitivities[m + 1] = local[:, :carried] @ before[2:]
            sensitivities[m + 1, :2] += before[:2]
            if m > 0:
                sensitivities[m + 1, :, 2 * m - 2 : 2 * m] += local[:, carried : carried + 2]
            sensitivities[m + 1, :, 2 * m : 2 * m + 2] += local[:, carried + 2 :]
    return states, sensitivities


def _plain_step(problem: HoldProblem, directions: int) -> Step:
    function = tangent_step_function(directions)

    def step(
        q: Vector, u_start: Vector, u_end: Vector, h: float, *seeds: Vector
    ) -> tuple[Vector, Vector, Vector, Vector]:
        found = function(q, u_start, u_end, h, problem.constants, *seeds)
        moved, q_end, d_moved, dq_end = (np.array(value) for value in found)
        return moved.ravel(), q_end.ravel(), d_moved, dq_end

    return step


def _drift_step(problem: HoldProblem, directions: int) -> Step:
    function, torques = tangent_drift_step_function(directions), problem.drift[3:]

    def step(
        y: Vector, u_start: Vector, u_end: Vector, h: float, dy: Vector, *seeds: Vector
    ) -> tuple[Vector, Vector, Vector, Vector]:
        found = function(
            y[:4], y[4:], u_start, u_end, h, problem.constants, torques, dy[:4], dy[4:], *seeds
        )
        moved, q_end, end, d_moved, dq_end, d_end = (np.array(value) for value in found)
        y_end = np.concatenate((q_end, end)).ravel()
        return moved.ravel(), y_end, d_moved, np.vstack((dq_end, d_end))

    return step
