# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import threading
from dataclasses import replace

import numpy as np
import pytest
from compiled_solver import solve_compiled, solve_plain

from sphere_nmpc.solver.plain import expand
from sphere_nmpc.solver.problem import SolveStatus


@pytest.fixture(params=(solve_compiled, solve_plain), ids=("compiled", "plain"))
def solve(request):
    return request.param


def rest_start(problem):
    return np.zeros((problem.intervals, 2))


def random_start(problem, seed=1):
    return np.random.default_rng(seed).uniform(-100.0, 100.0, (problem.intervals, 2))


@pytest.mark.parametrize("seed", range(3))
def test_both_solvers_take_the_same_first_step(make_problem, kind, seed):
    problem = make_problem(kind, seed)
    # Every derivative enters it.
    ours, right = (
        each(problem, random_start(problem), max_iterations=1, initial_damping=10.0)
        for each in (solve_compiled, solve_plain)
    )
    assert (ours.iterations, ours.status) == (right.iterations, right.status)
    assert ours.cost == pytest.approx(right.cost, rel=1e-12)
    assert ours.kkt_residual == pytest.approx(right.kkt_residual, rel=1e-10)
    np.testing.assert_allclose(ours.inputs, right.inputs, rtol=1e-11, atol=1e-10)
    np.testing.assert_allclose(ours.states, right.states, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("seed", range(2))
def test_both_solvers_take_the_same_steps(make_problem, kind, seed):
    problem = make_problem(kind, seed)
    # Few steps: rounding grows along the way where the problem is flat.
    ours, right = (
        each(problem, random_start(problem), max_iterations=8)
        for each in (solve_compiled, solve_plain)
    )
    assert ours.iterations == right.iterations
    assert ours.status is right.status
    assert ours.cost == pytest.approx(right.cost, rel=1e-9)
    assert np.max(np.abs(ours.inputs - right.inputs)) < 1e-5
    assert np.max(np.abs((ours.states - right.states)[:, 6:])) < 1e-6
    assert ours.kkt_residual == pytest.approx(right.kkt_residual, rel=1e-5, abs=1e-8)


def test_solution_states_its_own_cost_states_and_residual(make_problem, kind, solve):
    problem = make_problem(kind)
    solution = solve(problem, random_start(problem), max_iterations=8)
    v = solution.inputs[1:].ravel() / problem.input_scale
    here = expand(problem, v)
    low, high = (b.ravel() / problem.input_scale for b in (problem.lower, problem.upper))
    residual = np.max(np.abs(np.clip(v - here.gradient, low, high) - v))
    assert solution.cost == pytest.approx(here.cost, rel=1e-9)
    assert np.allclose(solution.states, here.motion.states, atol=1e-9)
    assert solution.kkt_residual == pytest.approx(residual, rel=1e-4, abs=1e-9)
    assert np.array_equal(solution.inputs[0], problem.input_in_force)
    assert solution.solve_time > 0.0


def test_converged_point_is_stationary_and_no_random_neighbour_is_better(make_problem):
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


@pytest.mark.parametrize("scale", (100.0, 30.0, 7.0))
def test_bounds_hold_exactly(make_problem, kind, solve, scale):
    n = make_problem(kind).intervals
    bound = np.random.default_rng(2).uniform(1.0, 20.0, (n, 2)) / 3.0
    problem = make_problem(kind, lower=-bound, upper=2.0 * bound, input_scale=scale)
    solution = solve(problem, random_start(problem), max_iterations=10)
    assert np.all(solution.inputs[1:] >= problem.lower)
    assert np.all(solution.inputs[1:] <= problem.upper)
    active = (solution.inputs[1:] == problem.lower) | (solution.inputs[1:] == problem.upper)
    assert np.any(active), "the bounds have to be narrow enough to be active"


def test_fixed_knots_stay_where_they_are(make_problem, kind, solve):
    problem = make_problem(kind)
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[-1] = upper[-1] = 0.0
    lower[0, 1] = upper[0, 1] = 12.5
    problem = replace(problem, lower=lower, upper=upper)
    solution = solve(problem, random_start(problem), max_iterations=10)
    fixed = lower == upper
    assert np.array_equal(solution.inputs[1:][fixed], lower[fixed])
    assert (solution.iterations > 0) == (not fixed.all())


def test_penalty_limits_the_accelerations(make_problem):
    problem = make_problem("acceleration", max_acceleration=60.0, unequal=False)
    free = replace(problem, max_acceleration=np.inf)
    reach = problem.max_acceleration * problem.durations[:, None]
    found = (solve_compiled(p, random_start(p), max_iterations=300) for p in (free, problem))
    beyond = [np.max(np.abs(np.diff(each.inputs, axis=0)) - reach) for each in found]
    assert beyond[0] > 50.0, "without the penalty the limit has to be exceeded"
    assert beyond[1] < 5.0


class TestStatus:
    @pytest.mark.parametrize(
        ("settings", "status", "iterations"),
        [
            ({"max_iterations": 2}, SolveStatus.CAPPED, 2),
            ({"time_budget": 0.0}, SolveStatus.BUDGET, 0),
            ({"target_cost": 1e6}, SolveStatus.CONVERGED, 0),
        ],
    )
    def test_end_before_convergence(self, make_problem, solve, settings, status, iterations):
        problem = make_problem("paper")
        solution = solve(problem, rest_start(problem), **settings)
        assert (solution.status, solution.iterations) == (status, iterations)
        assert np.isfinite(solution.cost)

    def test_not_finite(self, make_problem, solve):
        problem = make_problem("paper", state=np.full(9, np.nan))
        start = np.full((4, 2), 500.0)
        solution = solve(problem, start)
        assert solution.status is SolveStatus.NOT_FINITE
        assert np.all(solution.inputs[1:] == 100.0), "the bounds hold whatever the status"

    @pytest.mark.parametrize("kind_of_hessian", ["paper", "terminal"])
    def test_gradient_that_is_not_a_number_in_one_component(
        self, make_problem, solve, kind_of_hessian
    ):
        # Twice the weight is infinite. Knots at zero have a gradient of inf times 0; the others
        # are at their lower bounds, and their part of the projected gradient is zero.
        problem = make_problem(kind_of_hessian, input_weight=1e308)
        lower = np.full_like(problem.lower, 10.0)
        lower[0, 0] = 0.0
        with np.errstate(invalid="ignore", over="ignore"):
            solution = solve(replace(problem, lower=lower), rest_start(problem))
        assert np.isfinite(solution.cost)
        assert np.isnan(solution.kkt_residual)
        assert solution.status is SolveStatus.NOT_FINITE

    def test_no_step_lowers_the_cost_by_more_than_its_rounding(self, make_problem, solve):
        problem = make_problem("paper")
        solution = solve(
            problem, rest_start(problem), max_iterations=10_000, gradient_tolerance=0.0,
            decrease_tolerance=0.0,
        )
        assert 0.0 < solution.kkt_residual < 1e-6
        assert solution.status is SolveStatus.STALLED


def test_many_threads_solve_at_once(make_problem):
    problems = [make_problem("paper", seed) for seed in range(16)]
    alone = [solve_compiled(each, rest_start(each), max_iterations=20) for each in problems]
    together = [None] * len(problems)

    def work(i):
        for _ in range(20):
            together[i] = solve_compiled(problems[i], rest_start(problems[i]), max_iterations=20)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(problems))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.inputs, other.inputs)
