# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ends of a plan: at rest, at given speeds, or free."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from compiled_solver import solve_compiled, solve_plain
from solver_problems import AT_SPEED, make_problem

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import Disturbance, after_slope, rest_speeds
from sphere_nmpc.model.state import MOMENTUM, POSITION, QUATERNION, Vector
from sphere_nmpc.solver.problem import End, MinimumTimeProblem, Problem, Solution
from sphere_nmpc.solver.roll_out import roll_out

BOTH = pytest.mark.parametrize("solve", [solve_compiled, solve_plain], ids=["compiled", "plain"])
ENDS = pytest.mark.parametrize("end", [End.REST, End.STATE])


def start_of(problem: Problem, seed: int) -> Vector:
    return np.random.default_rng(seed).uniform(-90.0, 90.0, (problem.intervals, 2))


@pytest.mark.parametrize("kind", ["minimum time", "whole turns", "moving in minimum time"])
@BOTH
def test_plan_to_rest_is_that_of_a_last_knot_with_bounds_at_zero(solve: Any, kind: str) -> None:
    by_end, by_bounds = make_problem(kind, 1), make_problem(kind, 1)
    by_bounds.lower[-1] = by_bounds.upper[-1] = 0.0
    found, expected = (
        solve(one, start_of(one, 1), max_iterations=3, decrease_floor=1e-8)
        for one in (by_end, by_bounds)
    )
    # The steps are the same up to rounding, which these problems amplify.
    assert (found.cost, found.stretch) == pytest.approx((expected.cost, expected.stretch), 1e-6)
    assert not found.inputs[-1].any()


def fastest(problem: MinimumTimeProblem, guess: Vector) -> tuple[MinimumTimeProblem, Solution]:
    """Return a problem on the time of its solution, and the solution."""
    found = solve_compiled(problem, guess, max_iterations=400, decrease_floor=1e-7)
    return replace(problem, durations=found.stretch * problem.durations), found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("momentum", [(0.0, 0.0, 0.0), (20.0, -30.0, 0.0)])
def test_plan_arrives_at_given_speeds_before_one_to_rest_and_after_one_with_a_free_end(
    momentum: tuple[float, float, float], seed: int
) -> None:
    problem: Any = make_problem(
        "minimum time", seed, error_weight=20.0, input_in_force=np.zeros(2), unequal=False
    )
    goal = problem.goal[QUATERNION]
    # Of which the rotors can hold all at the goal.
    problem.state[MOMENTUM] = rotation.matrix(goal) @ momentum
    held = np.array(momentum[:2])
    problem, rest = fastest(problem, start_of(problem, seed))
    problem, free = fastest(replace(problem, end=End.FREE), rest.inputs[1:])
    speeds = 0.5 * (free.inputs[-1] - held)
    at_speed = replace(problem, end=End.STATE, end_speeds=speeds)
    problem, given = fastest(at_speed, free.inputs[1:])
    duration = float(np.sum(problem.durations))
    # Costs are durations of plans without an error.
    assert free.cost < given.cost < rest.cost - 0.01
    assert given.cost - duration < 1e-4
    np.testing.assert_allclose(given.inputs[-1], speeds + held, atol=1e-3)
    end = given.states[-1]
    np.testing.assert_allclose(end[POSITION], problem.goal[POSITION], atol=1e-5)
    assert abs(end[QUATERNION] @ goal) == pytest.approx(1.0, abs=1e-9)
    # The velocity is that of a sphere without momentum at these speeds.
    instant = np.array([1e-5])
    ends = (end, np.concatenate((end[:6], np.zeros(3))))
    moved, expected = (
        roll_out(x, np.tile(u, (2, 1)), instant, problem.constants)[1, POSITION] - x[POSITION]
        for x, u in zip(ends, (given.inputs[-1], speeds), strict=True)
    )
    assert np.linalg.norm(expected) > 0.05 * instant[0]
    np.testing.assert_allclose(moved, expected, atol=1e-4 * instant[0])
    # A free end from there is no worse, as that plan is one.
    again = fastest(replace(problem, end=End.FREE), given.inputs[1:])[1]
    assert again.cost < given.cost + 1e-6


@ENDS
@BOTH
def test_plan_of_given_duration_ends_at_speeds_that_hold_the_momentum(
    solve: Any, end: End
) -> None:
    problem = make_problem("at speed, momentum", end=end)
    found = solve(problem, start_of(problem, 1), max_iterations=5)
    disturbance = Disturbance.from_array(problem.torques)
    duration = float(np.sum(problem.durations))
    momentum = after_slope(problem.state[MOMENTUM], disturbance, duration)
    speeds = AT_SPEED["end_speeds"] if end is End.STATE else np.zeros(2)
    held = rest_speeds(momentum, problem.goal[QUATERNION])
    np.testing.assert_allclose(found.inputs[-1], speeds + held, atol=1e-12)


@pytest.mark.parametrize("kind", ["at speed", "at speed, disturbed", "at speed, momentum"])
@BOTH
def test_speeds_beyond_the_bounds_end_at_them(solve: Any, kind: str) -> None:
    problem = make_problem(kind, end_speeds=np.array([250.0, -25.0]))
    problem.lower[-1] = -30.0
    problem.upper[-1] = (80.0, 30.0)
    found = solve(problem, start_of(problem, 1), max_iterations=40, decrease_floor=1e-4)
    assert found.inputs[-1, 0] <= 80.0
    # With momentum in minimum time the knot is not fixed, but found.
    assert found.inputs[-1, 0] == pytest.approx(80.0, abs=1e-5)
    if kind == "at speed":
        assert found.inputs[-1, 1] == -25.0
        duration = found.stretch * float(np.sum(problem.durations))
        excess = (250.0 - 80.0) / problem.input_scale
        assert found.cost - duration > 0.999 * excess * problem.error_weight


@ENDS
@pytest.mark.parametrize("kind", ["terminal", "minimum time", "disturbed"])
@BOTH
def test_end_that_is_not_a_number_keeps_the_bounds(solve: Any, kind: str, end: End) -> None:
    problem = make_problem(
        kind, end=end, goal=np.full(6, np.nan), end_speeds=np.array([np.nan, np.inf])
    )
    found = solve(problem, start_of(problem, 1), max_iterations=2, decrease_floor=1e-4)
    assert np.all(found.inputs[1:] >= problem.lower)
    assert np.all(found.inputs[1:] <= problem.upper)
