# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Both problems by both solvers: derivatives, equal steps, limits, status, optima."""

import contextlib
import threading
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from compiled_solver import solve_compiled, solve_plain
from scipy.optimize import minimize
from solver_problems import KINDS, LEAST_SQUARES, MINIMUM_TIME, make_problem

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import rest_speeds
from sphere_nmpc.model.state import MOMENTUM, POSITION, QUATERNION, Vector
from sphere_nmpc.solver.minimum_time import expand_error
from sphere_nmpc.solver.plain import aim_of, bounds_of, expand
from sphere_nmpc.solver.problem import (
    End,
    LeastSquaresProblem,
    Problem,
    SolverSettings,
    SolveStatus,
)
from sphere_nmpc.solver.solve import solve_all

STEP = 1e-6
"""Of a scaled input; a central difference is then good to about 1e-9."""
BOTH = pytest.mark.parametrize("solve", [solve_compiled, solve_plain], ids=["compiled", "plain"])


def rest_start(problem: Problem) -> Vector:
    return np.zeros((problem.intervals, 2))


def random_start(problem: Problem, seed: int = 1) -> Vector:
    """Return knots; a problem of minimum time begins within its bounds."""
    knots = np.random.default_rng(seed).uniform(-90.0, 90.0, (problem.intervals, 2))
    is_free = isinstance(problem, LeastSquaresProblem)
    return knots if is_free else np.clip(knots, *bounds_of(problem))


def shifts(size: int) -> list[Vector]:
    return list(STEP * np.eye(size))


@pytest.mark.parametrize("kind", LEAST_SQUARES)
def test_derivatives_of_the_cost_agree_with_finite_differences(kind: str) -> None:
    problem = make_problem(kind)
    v = random_start(problem).ravel() / problem.input_scale
    here = expand(problem, v)
    for i, change in enumerate(shifts(v.size)):
        ahead, behind = expand(problem, v + change), expand(problem, v - change)
        slope = (ahead.cost - behind.cost) / (2.0 * STEP)
        assert slope == pytest.approx(here.gradient[i], abs=1e-6, rel=1e-6)
        found = (ahead.motion.states - behind.motion.states) / (2.0 * STEP * problem.input_scale)
        assert np.allclose(found, here.motion.derivatives[:, :, i], atol=1e-7)


@pytest.mark.parametrize("kind", MINIMUM_TIME)
def test_derivatives_of_the_error_agree_with_finite_differences(kind: str) -> None:
    problem, stretch = make_problem(kind), 1.1
    v = random_start(problem).ravel() / problem.input_scale
    here = expand_error(problem, v, stretch)

    def slope(change: Vector, by: float = 0.0) -> Vector:
        ahead, behind = (
            expand_error(problem, v + sign * change, stretch * np.exp(sign * by)).error
            for sign in (1.0, -1.0)
        )
        return (ahead - behind) / (2.0 * STEP)

    lower, upper = bounds_of(problem)
    is_free = (lower < upper).ravel()
    expected = np.column_stack([slope(change) for change in shifts(v.size)]) * is_free
    np.testing.assert_allclose(here.by_knots, expected, atol=1e-6, rtol=1e-6)
    np.testing.assert_allclose(
        here.by_stretch, slope(np.zeros(v.size), STEP), atol=1e-6, rtol=1e-6
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("kind", "settings", "cost", "residual", "inputs"),
    [
        # Every derivative enters the first step.
        *((kind, {"max_iterations": 1, "initial_damping": 10.0}, 1e-12, 1e-10, 1e-10)
          for kind in LEAST_SQUARES),
        # Few steps: rounding grows along the way where the problem is flat.
        *((kind, {"max_iterations": 8}, 1e-9, 1e-5, 1e-5) for kind in LEAST_SQUARES),
        # A small floor, so that both solve the program of a step, which every derivative enters.
        *((kind, {"max_iterations": 3, "decrease_floor": 1e-8}, 1e-6, 1e-5, 1e-3)
          for kind in MINIMUM_TIME),
    ],
)
def test_both_solvers_take_the_same_steps(
    kind: str, settings: dict[str, Any], cost: float, residual: float, inputs: float, seed: int
) -> None:
    problem = make_problem(kind, seed)
    ours, right = (
        each(problem, random_start(problem, seed), **settings)
        for each in (solve_compiled, solve_plain)
    )
    assert (ours.iterations, ours.status) == (right.iterations, right.status)
    assert ours.cost == pytest.approx(right.cost, rel=cost)
    assert ours.kkt_residual == pytest.approx(right.kkt_residual, rel=residual, abs=residual)
    assert ours.stretch == pytest.approx(right.stretch, abs=1e-7)
    np.testing.assert_allclose(ours.inputs, right.inputs, rtol=1e-11, atol=inputs)
    np.testing.assert_allclose(ours.states, right.states, rtol=1e-12, atol=0.1 * inputs)


@pytest.mark.parametrize("kind", KINDS)
@BOTH
def test_solution_keeps_all_limits_and_states_its_own_cost_states_and_residual(
    kind: str, solve: Any
) -> None:
    problem, floor = make_problem(kind, 2), 0.0 if kind in LEAST_SQUARES else 1e-4
    found = solve(problem, random_start(problem), max_iterations=8, decrease_floor=floor)
    v = found.inputs[1:].ravel() / problem.input_scale
    lower, upper = bounds_of(problem)
    if kind in LEAST_SQUARES:
        here = expand(problem, v)
        cost, states = here.cost, here.motion.states
        low, high = (b.ravel() / problem.input_scale for b in (lower, upper))
        residual = np.max(np.abs(np.clip(v - here.gradient, low, high) - v))
        assert found.kkt_residual == pytest.approx(residual, rel=1e-4, abs=1e-9)
    else:
        point = expand_error(problem, v, found.stretch)
        cost, states = point.merit, point.states
        reach = problem.max_acceleration * found.stretch * problem.durations[:, None]
        # Of what the program of a step is solved to, 1e-8 of the largest speed.
        assert np.max(np.abs(np.diff(found.inputs, axis=0)) - reach) < 1e-5
    assert found.cost == pytest.approx(cost, rel=1e-9)
    np.testing.assert_allclose(found.states, states, atol=1e-9)
    assert np.array_equal(found.inputs[0], problem.input_in_force)
    kept = np.clip(found.inputs[1:], lower, upper)
    np.testing.assert_allclose(found.inputs[1:], kept, atol=1e-12)
    assert np.all(found.inputs[1:] >= problem.lower)
    assert np.all(found.inputs[1:] <= problem.upper)
    assert found.solve_time > 0.0


@pytest.mark.parametrize("scale", [100.0, 30.0, 7.0])
@pytest.mark.parametrize("kind", LEAST_SQUARES)
@BOTH
def test_bounds_and_fixed_knots_hold_exactly(kind: str, solve: Any, scale: float) -> None:
    n = KINDS[kind]["intervals"]
    bound = np.random.default_rng(2).uniform(1.0, 20.0, (n, 2)) / 3.0
    bounds = {"lower": -bound, "upper": 2.0 * bound, "input_scale": scale}
    for fixed in ({}, {0: (0.1, 1.5), -1: (0.0, 0.0)}):
        problem = make_problem(kind, **bounds, fixed=fixed)
        solution = solve(problem, random_start(problem), max_iterations=10)
        assert np.array_equal(solution.inputs[0], problem.input_in_force)
        assert np.all(solution.inputs[1:] >= problem.lower)
        assert np.all(solution.inputs[1:] <= problem.upper)
        is_fixed = problem.lower == problem.upper
        assert (solution.iterations > 0) == (not is_fixed.all())
        active = (solution.inputs[1:] == problem.lower) | (solution.inputs[1:] == problem.upper)
        assert fixed or np.any(active), "the bounds have to be narrow enough to be active"


def test_converged_point_is_stationary_and_no_random_neighbour_is_better() -> None:
    problem = make_problem("paper", unequal=False)
    solution = solve_compiled(
        problem, rest_start(problem), max_iterations=500, decrease_tolerance=1e-14
    )
    assert solution.status is SolveStatus.CONVERGED
    assert solution.kkt_residual < 1e-6
    rng = np.random.default_rng(0)
    v = solution.inputs[1:].ravel() / problem.input_scale
    for _ in range(20):
        near = np.clip(v + 1e-3 * rng.normal(size=v.size), -1.0, 1.0)
        assert expand(problem, near).cost > solution.cost - 1e-9


def test_penalty_limits_the_accelerations() -> None:
    beyond = []
    for limit in (np.inf, 60.0):
        problem = make_problem("acceleration", max_acceleration=limit, unequal=False)
        found = solve_compiled(problem, random_start(problem), max_iterations=300)
        reach = 60.0 * problem.durations[:, None]
        beyond.append(np.max(np.abs(np.diff(found.inputs, axis=0)) - reach))
    assert beyond[0] > 50.0, "without the penalty the limit has to be exceeded"
    assert beyond[1] < 5.0


@pytest.mark.parametrize(
    ("kind", "settings", "status", "iterations"),
    [
        *((kind, settings, status, iterations) for kind in ("paper", *MINIMUM_TIME)
          for settings, status, iterations in (
              ({"max_iterations": 2}, SolveStatus.CAPPED, 2),
              ({"time_budget": 0.0}, SolveStatus.BUDGET, 0),
          )),
        ("paper", {"target_cost": 1e6}, SolveStatus.CONVERGED, 0),
        ("minimum time", {"decrease_floor": 1e6}, SolveStatus.CONVERGED, 1),
    ],
)
@BOTH
def test_end_before_convergence(kind, solve, settings, status, iterations) -> None:
    problem = make_problem(kind)
    solution = solve(problem, random_start(problem), **{"decrease_floor": 1e-6, **settings})
    assert (solution.status, solution.iterations) == (status, iterations)
    assert np.isfinite(solution.cost)


@pytest.mark.parametrize("kind", ["paper", *MINIMUM_TIME])
@BOTH
def test_bounds_hold_also_where_nothing_is_finite(kind: str, solve: Any) -> None:
    problem = make_problem(kind, state=np.full(9, np.nan))
    solution = solve(problem, np.full((problem.intervals, 2), 500.0))
    assert solution.status is SolveStatus.NOT_FINITE
    assert np.all(solution.inputs[1:] <= problem.upper)
    assert np.all(solution.inputs[1:] >= problem.lower)


@pytest.mark.parametrize("kind", ["paper", "terminal"])
@BOTH
def test_gradient_that_is_not_a_number_in_one_component(kind: str, solve: Any) -> None:
    # Twice the weight is infinite. Knots at zero have a gradient of inf times 0; the others
    # are at their lower bounds, and their part of the projected gradient is zero.
    problem = make_problem(kind, input_weight=1e308)
    problem.lower[:] = 10.0
    problem.lower[0, 0] = 0.0
    with np.errstate(invalid="ignore", over="ignore"):
        solution = solve(problem, rest_start(problem))
    assert np.isfinite(solution.cost)
    assert np.isnan(solution.kkt_residual)
    assert solution.status is SolveStatus.NOT_FINITE


@BOTH
def test_no_step_lowers_the_cost_by_more_than_its_rounding(solve: Any) -> None:
    problem = make_problem("paper")
    solution = solve(
        problem, rest_start(problem), max_iterations=10_000, gradient_tolerance=0.0,
        decrease_tolerance=0.0,
    )
    assert 0.0 < solution.kkt_residual < 1e-6
    assert solution.status is SolveStatus.STALLED


def test_many_threads_solve_at_once() -> None:
    problems = [make_problem("paper", seed) for seed in range(16)]
    alone = [solve_compiled(each, rest_start(each), max_iterations=20) for each in problems]
    together: list[Any] = [None] * len(problems)

    def work(i: int) -> None:
        for _ in range(20):
            together[i] = solve_compiled(problems[i], rest_start(problems[i]), max_iterations=20)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(problems))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.inputs, other.inputs)


@pytest.mark.parametrize("kind", ["acceleration", "momentum", "minimum time", "effort"])
def test_problems_of_one_call_are_solved_as_each_alone_and_by_the_plain_solver(kind: str) -> None:
    problems = [make_problem(kind, n, intervals=n, fixed={}) for n in (9, 5, 9, 14)]
    starts = [random_start(problem) for problem in problems]
    settings = SolverSettings(3, decrease_floor=1e-8, initial_damping=1.0)
    together = solve_all(problems, starts, settings)
    alone = [
        solve_all([problem], [start], settings)[0]
        for problem, start in zip(problems, starts, strict=True)
    ]
    with mock.patch(f"{solve_all.__module__}.library", lambda: None):
        plain = solve_all(problems, starts, settings)
    for ours, one, right in zip(together, alone, plain, strict=True):
        np.testing.assert_array_equal(ours.inputs, one.inputs)
        np.testing.assert_array_equal(ours.states, one.states)
        assert (ours.cost, ours.stretch) == (one.cost, one.stretch)
        assert (ours.iterations, ours.status) == (right.iterations, right.status)
        assert ours.cost == pytest.approx(right.cost, rel=1e-6)
        np.testing.assert_allclose(ours.inputs, right.inputs, atol=1e-3)


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "plain"])
def test_time_budget_is_that_of_all_problems_of_a_call(compiled: bool) -> None:
    problems = [make_problem("terminal", seed) for seed in range(3)]
    starts = [random_start(problem) for problem in problems]
    with contextlib.nullcontext() if compiled else mock.patch(
        f"{solve_all.__module__}.library", lambda: None
    ):
        found = solve_all(problems, starts, SolverSettings(), 0.0)
    assert [(one.status, one.iterations) for one in found] == [(SolveStatus.BUDGET, 0)] * 3


@pytest.mark.parametrize("kind", MINIMUM_TIME)
def test_error_vanishes_where_it_weighs_enough(kind: str) -> None:
    problem = make_problem(kind, 1)
    # A goal that can be reached: the end of the motion along a guess within the limits.
    guess = solve_compiled(problem, random_start(problem), max_iterations=0)
    goal = guess.states[-1, :6].copy()
    goal[POSITION] -= guess.stretch * float(np.sum(problem.durations)) * problem.goal_velocity
    problem = replace(
        problem, goal=goal, momentum_row=np.zeros(3), steady_axis=np.zeros(2), error_weight=1e3,
    )
    found = solve_compiled(problem, guess.inputs[1:], max_iterations=400, decrease_floor=1e-6)
    duration = found.stretch * float(np.sum(problem.durations))
    effort = problem.effort(found.inputs, found.stretch)
    assert found.cost - duration - effort < 1e-4
    end = found.states[-1]
    there = goal[POSITION] + duration * problem.goal_velocity
    np.testing.assert_allclose(end[POSITION], there, atol=1e-5)
    upright = rotation.vertical(np.array([end[QUATERNION], goal[QUATERNION]]))
    np.testing.assert_allclose(upright[0], upright[1], atol=1e-5)
    if problem.turn_weights.all():
        assert abs(end[QUATERNION] @ goal[QUATERNION]) == pytest.approx(1.0, abs=1e-9)
    if problem.end is not End.FREE:
        held = rest_speeds(end[MOMENTUM], goal[QUATERNION])
        np.testing.assert_allclose(found.inputs[-1], aim_of(problem) + held, atol=1e-3)


@pytest.mark.parametrize(
    ("kind", "changes"),
    [("minimum time", {}), ("at speed", {}), ("free end", {}), ("effort", {}),
     ("effort", {"least_duration": 0.0})],
)
def test_duration_and_effort_are_those_of_a_general_solver(
    kind: str, changes: dict[str, float]
) -> None:
    problem = make_problem(
        kind, 3, intervals=8, unequal=False, input_in_force=np.zeros(2), **changes
    )
    ours = solve_compiled(problem, random_start(problem), max_iterations=300, decrease_floor=1e-8)
    duration, size = float(np.sum(problem.durations)), 2 * problem.intervals
    reach = problem.max_acceleration / problem.input_scale * np.repeat(problem.durations, 2)
    differences = np.eye(size) - np.eye(size, k=-2)

    def point(x: Vector) -> Any:
        return expand_error(problem, x[:-1], float(x[-1]))

    def jacobian(x: Vector) -> Vector:
        here = point(x)
        # A knot that is fixed is a variable of this one.
        return np.column_stack((here.by_knots, here.by_stretch / x[-1]))[:5]

    limits = [
        {"type": "eq", "fun": lambda x: point(x).error[:5], "jac": jacobian},
        *({"type": "ineq", "fun": lambda x, sign=sign: x[-1] * reach + sign * differences @ x[:-1],
           "jac": lambda _, sign=sign: np.column_stack((sign * differences, reach))}
          for sign in (-1.0, 1.0)),
    ]
    edges = [knots.ravel() / problem.input_scale for knots in bounds_of(problem)]
    shortest = max(0.1, problem.least_duration / duration)
    weights = problem.effort_weight * np.repeat(problem.durations, 2) / reach**2

    def effort(x: Vector) -> float:
        return float(weights @ (differences @ x[:-1]) ** 2) / x[-1]

    start = np.append(ours.inputs[1:].ravel() / problem.input_scale, ours.stretch)
    rng = np.random.default_rng(0)
    for _ in range(3):
        right = minimize(
            lambda x: duration * x[-1] + effort(x), start + 0.02 * rng.normal(size=start.size),
            jac=lambda x: np.append(
                2.0 / x[-1] * differences.T @ (weights * (differences @ x[:-1])),
                duration - effort(x) / x[-1],
            ),
            bounds=[*zip(*edges, strict=True), (shortest, 10.0)], constraints=limits,
            method="SLSQP", options={"maxiter": 300, "ftol": 1e-10},
        )
        assert right.success
        assert ours.cost < right.fun + 1e-5


@BOTH
def test_guess_that_is_too_fast_gets_more_time(solve: Any) -> None:
    problem = make_problem(
        "minimum time", intervals=2, durations=np.array([0.05, 0.05]),
        input_in_force=np.array([80.0, 0.0]),
    )
    found = solve(problem, np.zeros((2, 2)), max_iterations=1, decrease_floor=1e-4)
    assert found.stretch >= 2.0 - 1e-9
    change = np.abs(np.diff(found.inputs, axis=0))
    assert np.max(change - 400.0 * found.stretch * problem.durations[:, None]) < 1e-5
