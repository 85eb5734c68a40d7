# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The minimum-time problem: derivatives, limits, an independent optimum, both solvers."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from compiled_solver import solve_compiled, solve_plain
from scipy.optimize import minimize

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import rest_speeds
from sphere_nmpc.model.state import MOMENTUM, POSITION, QUATERNION, Vector
from sphere_nmpc.solver.minimum_time import expand_error
from sphere_nmpc.solver.problem import MinimumTimeProblem, SolveStatus

STEP = 1e-6
"""Of a scaled input; a central difference is then good to about 1e-9."""
MOMENTUM_GIVEN = np.array([25.0, -40.0, 3.0])
DISTURBED: dict[str, Any] = {
    "momentum": MOMENTUM_GIVEN,
    "torques": np.array([8.0, -5.0, 3.0, 4.0, -2.0]),
    "momentum_row": np.array([0.01, -0.02, 0.015]),
    "position_scale": 2.5,
}
ROLLING: dict[str, Any] = {
    "durations": np.array([0.3, 0.2, 0.25, 0.25, 15.0, 0.2, 0.3, 0.25, 0.1]),
    "steady_interval": 4,
    "steady_axis": np.array([0.6, -0.8]),
    "whole_turns": 13.7,
}
MOVING: dict[str, Any] = {
    "turn_weights": np.array([1.0, 1.0, 0.0]), "goal_velocity": np.array([0.3, -0.1]),
}
KINDS: dict[str, dict[str, Any]] = {
    "undisturbed": {}, "disturbed": DISTURBED, "whole turns": ROLLING, "moving": MOVING,
    "moving, disturbed": {**DISTURBED, **MOVING},
}


@pytest.fixture(params=list(KINDS))
def make(request: pytest.FixtureRequest, make_problem: Any) -> Callable[[int], MinimumTimeProblem]:
    """Return the function that makes a problem of a kind from a seed: 9 intervals to rest."""

    def made(seed: int) -> MinimumTimeProblem:
        problem: MinimumTimeProblem = make_problem("minimum time", seed, **KINDS[request.param])
        lower, upper = problem.lower.copy(), problem.upper.copy()
        if "disturbed" not in request.param.split(", "):
            lower[-1] = upper[-1] = 0.0
        if problem.steady_interval:
            lower[3:5] = upper[3:5] = [100.0, -100.0]
        return replace(problem, lower=lower, upper=upper)

    return made


@pytest.fixture(params=[solve_compiled, solve_plain], ids=["compiled", "plain"])
def solve(request: pytest.FixtureRequest) -> Any:
    return request.param


def random_knots(problem: MinimumTimeProblem, seed: int = 1) -> Vector:
    knots: Vector = np.random.default_rng(seed).uniform(-90.0, 90.0, (problem.intervals, 2))
    return np.clip(knots, problem.lower, problem.upper)


def test_derivatives_agree_with_finite_differences(make: Any) -> None:
    problem = make(0)
    v = random_knots(problem).ravel() / problem.input_scale
    here = expand_error(problem, v, 1.1)
    free = (problem.lower < problem.upper).ravel()
    for i in np.flatnonzero(free):
        change = np.zeros(v.size)
        change[i] = STEP
        ahead, behind = (expand_error(problem, v + d, 1.1).error for d in (change, -change))
        found = (ahead - behind) / (2.0 * STEP)
        np.testing.assert_allclose(found, here.by_knots[:, i], atol=1e-6, rtol=1e-6)
    assert not here.by_knots[:, ~free].any()
    ahead, behind = (
        expand_error(problem, v, 1.1 * np.exp(d)).error for d in (STEP, -STEP)
    )
    found = (ahead - behind) / (2.0 * STEP)
    np.testing.assert_allclose(found, here.by_stretch, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_both_forms_take_the_same_steps(make: Any, seed: int) -> None:
    problem = make(seed)
    # A small floor, so that both solve the program of a step, which every derivative enters.
    ours, right = (
        each(problem, random_knots(problem, seed), max_iterations=3, decrease_floor=1e-8)
        for each in (solve_compiled, solve_plain)
    )
    assert (ours.iterations, ours.status) == (right.iterations, right.status)
    assert ours.cost == pytest.approx(right.cost, abs=1e-5)
    assert ours.kkt_residual == pytest.approx(right.kkt_residual, abs=1e-5)
    assert ours.stretch == pytest.approx(right.stretch, abs=1e-7)
    np.testing.assert_allclose(ours.inputs, right.inputs, atol=1e-3)


def test_solution_keeps_all_limits_and_states_its_own_cost(make: Any, solve: Any) -> None:
    problem = make(2)
    found = solve(problem, random_knots(problem), max_iterations=8, decrease_floor=1e-4)
    assert np.array_equal(found.inputs[0], problem.input_in_force)
    assert np.all(found.inputs[1:] >= problem.lower)
    assert np.all(found.inputs[1:] <= problem.upper)
    reach = problem.max_acceleration * found.stretch * problem.durations[:, None]
    # Of what the program of a step is solved to, 1e-8 of the largest speed.
    assert np.max(np.abs(np.diff(found.inputs, axis=0)) - reach) < 1e-5
    here = expand_error(problem, found.inputs[1:].ravel() / problem.input_scale, found.stretch)
    assert found.cost == pytest.approx(here.merit, rel=1e-9)
    np.testing.assert_allclose(found.states, here.states, atol=1e-9)


def test_error_vanishes_where_it_weighs_enough(make: Any) -> None:
    problem = make(1)
    # A goal that can be reached: the end of the motion along a guess within the limits.
    guess = solve_compiled(problem, random_knots(problem), max_iterations=0)
    goal = guess.states[-1, :6].copy()
    goal[POSITION] -= guess.stretch * float(np.sum(problem.durations)) * problem.goal_velocity
    problem = replace(
        problem, goal=goal, momentum_row=np.zeros(3), steady_axis=np.zeros(2),
        error_weight=1e3,
    )
    found = solve_compiled(problem, guess.inputs[1:], max_iterations=200, decrease_floor=1e-6)
    duration = found.stretch * float(np.sum(problem.durations))
    assert found.cost - duration < 1e-4
    end, goal = found.states[-1], problem.goal
    there = goal[POSITION] + duration * problem.goal_velocity
    np.testing.assert_allclose(end[POSITION], there, atol=1e-5)
    upright = rotation.vertical(np.array([end[QUATERNION], goal[QUATERNION]]))
    np.testing.assert_allclose(upright[0], upright[1], atol=1e-5)
    if problem.turn_weights.all():
        assert abs(end[QUATERNION] @ goal[QUATERNION]) == pytest.approx(1.0, abs=1e-9)
    held = rest_speeds(end[MOMENTUM], goal[QUATERNION])
    np.testing.assert_allclose(found.inputs[-1], held, atol=1e-3)


def test_duration_is_that_of_a_general_solver(make_problem: Any) -> None:
    problem = make_problem(
        "minimum time", 3, intervals=10, unequal=False, input_in_force=np.zeros(2)
    )
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[-1] = upper[-1] = 0.0
    problem = replace(problem, lower=lower, upper=upper)
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
        {"type": "ineq", "fun": lambda x: x[-1] * reach - differences @ x[:-1],
         "jac": lambda x: np.column_stack((-differences, reach))},
        {"type": "ineq", "fun": lambda x: x[-1] * reach + differences @ x[:-1],
         "jac": lambda x: np.column_stack((differences, reach))},
    ]
    bounds = [*zip(lower.ravel() / 100.0, upper.ravel() / 100.0, strict=True), (0.1, 10.0)]
    start = np.append(ours.inputs[1:].ravel() / problem.input_scale, ours.stretch)
    rng = np.random.default_rng(0)
    for _ in range(3):
        right = minimize(
            lambda x: duration * x[-1], start + 0.02 * rng.normal(size=start.size),
            jac=lambda x: np.append(np.zeros(size), duration), bounds=bounds, constraints=limits,
            method="SLSQP", options={"maxiter": 300, "ftol": 1e-10},
        )
        assert right.success
        assert ours.cost < right.fun + 1e-5


def test_guess_that_is_too_fast_gets_more_time(make_problem: Any, solve: Any) -> None:
    problem = make_problem(
        "minimum time", intervals=2, durations=np.array([0.05, 0.05]),
        input_in_force=np.array([80.0, 0.0]),
    )
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[-1] = upper[-1] = 0.0
    found = solve(
        replace(problem, lower=lower, upper=upper), np.zeros((2, 2)), max_iterations=1,
        decrease_floor=1e-4,
    )
    assert found.stretch >= 2.0 - 1e-9
    change = np.abs(np.diff(found.inputs, axis=0))
    assert np.max(change - 400.0 * found.stretch * problem.durations[:, None]) < 1e-5


@pytest.mark.parametrize(
    ("settings", "status", "iterations"),
    [
        ({"max_iterations": 2}, SolveStatus.CAPPED, 2),
        ({"time_budget": 0.0}, SolveStatus.BUDGET, 0),
        ({"decrease_floor": 1e6}, SolveStatus.CONVERGED, 1),
    ],
)
def test_status(make: Any, solve: Any, settings: Any, status: Any, iterations: int) -> None:
    problem = make(0)
    found = solve(problem, random_knots(problem), **{"decrease_floor": 1e-6, **settings})
    assert (found.status, found.iterations) == (status, iterations)


def test_not_finite(make: Any, solve: Any) -> None:
    problem = replace(make(0), state=np.full(9, np.nan))
    found = solve(problem, np.full((9, 2), 500.0))
    assert found.status is SolveStatus.NOT_FINITE
    assert np.all(found.inputs[1:] <= problem.upper)
