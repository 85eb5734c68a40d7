# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solutions in minimum time: the error vanishes, an independent optimum, guesses too fast."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from compiled_solver import solve_compiled, solve_plain
from scipy.optimize import minimize
from solver_problems import MINIMUM_TIME, make_problem

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import rest_speeds
from sphere_nmpc.model.state import MOMENTUM, POSITION, QUATERNION, Vector
from sphere_nmpc.solver.minimum_time import expand_error
from sphere_nmpc.solver.problem import MinimumTimeProblem


def random_knots(problem: MinimumTimeProblem) -> Vector:
    knots: Vector = np.random.default_rng(1).uniform(-90.0, 90.0, (problem.intervals, 2))
    return np.clip(knots, problem.lower, problem.upper)


@pytest.mark.parametrize("kind", MINIMUM_TIME)
def test_error_vanishes_where_it_weighs_enough(kind: str) -> None:
    problem = make_problem(kind, 1)
    # A goal that can be reached: the end of the motion along a guess within the limits.
    guess = solve_compiled(problem, random_knots(problem), max_iterations=0)
    goal = guess.states[-1, :6].copy()
    goal[POSITION] -= guess.stretch * float(np.sum(problem.durations)) * problem.goal_velocity
    problem = replace(
        problem, goal=goal, momentum_row=np.zeros(3), steady_axis=np.zeros(2), error_weight=1e3,
    )
    found = solve_compiled(problem, guess.inputs[1:], max_iterations=200, decrease_floor=1e-6)
    duration = found.stretch * float(np.sum(problem.durations))
    assert found.cost - duration < 1e-4
    end = found.states[-1]
    there = goal[POSITION] + duration * problem.goal_velocity
    np.testing.assert_allclose(end[POSITION], there, atol=1e-5)
    upright = rotation.vertical(np.array([end[QUATERNION], goal[QUATERNION]]))
    np.testing.assert_allclose(upright[0], upright[1], atol=1e-5)
    if problem.turn_weights.all():
        assert abs(end[QUATERNION] @ goal[QUATERNION]) == pytest.approx(1.0, abs=1e-9)
    held = rest_speeds(end[MOMENTUM], goal[QUATERNION])
    np.testing.assert_allclose(found.inputs[-1], held, atol=1e-3)


def test_duration_is_that_of_a_general_solver() -> None:
    problem = make_problem(
        "minimum time", 3, intervals=10, unequal=False, input_in_force=np.zeros(2)
    )
    ours = solve_compiled(problem, random_knots(problem), max_iterations=300, decrease_floor=1e-8)
    duration, size = float(np.sum(problem.durations)), 2 * problem.intervals
    reach = problem.max_acceleration / problem.input_scale * np.repeat(problem.durations, 2)
    differences = np.eye(size) - np.eye(size, k=-2)

    def point(x: Vector) -> Any:
        return expand_error(problem, x[:-1], float(x[-1]))

    def jacobian(x: Vector) -> Vector:
        here = point(x)
        # The last knot is a variable of this one.
        return np.column_stack((here.by_knots, here.by_stretch / x[-1]))[:5]

    limits = [
        {"type": "eq", "fun": lambda x: point(x).error[:5], "jac": jacobian},
        *({"type": "ineq", "fun": lambda x, sign=sign: x[-1] * reach + sign * differences @ x[:-1],
           "jac": lambda _, sign=sign: np.column_stack((sign * differences, reach))}
          for sign in (-1.0, 1.0)),
    ]
    edges = (problem.lower.ravel() / 100.0, problem.upper.ravel() / 100.0)
    start = np.append(ours.inputs[1:].ravel() / problem.input_scale, ours.stretch)
    rng = np.random.default_rng(0)
    for _ in range(3):
        right = minimize(
            lambda x: duration * x[-1], start + 0.02 * rng.normal(size=start.size),
            jac=lambda x: np.append(np.zeros(size), duration),
            bounds=[*zip(*edges, strict=True), (0.1, 10.0)], constraints=limits,
            method="SLSQP", options={"maxiter": 300, "ftol": 1e-10},
        )
        assert right.success
        assert ours.cost < right.fun + 1e-5


@pytest.mark.parametrize("solve", [solve_compiled, solve_plain], ids=["compiled", "plain"])
def test_guess_that_is_too_fast_gets_more_time(solve: Any) -> None:
    problem = make_problem(
        "minimum time", intervals=2, durations=np.array([0.05, 0.05]),
        input_in_force=np.array([80.0, 0.0]),
    )
    found = solve(problem, np.zeros((2, 2)), max_iterations=1, decrease_floor=1e-4)
    assert found.stretch >= 2.0 - 1e-9
    change = np.abs(np.diff(found.inputs, axis=0))
    assert np.max(change - 400.0 * found.stretch * problem.durations[:, None]) < 1e-5
