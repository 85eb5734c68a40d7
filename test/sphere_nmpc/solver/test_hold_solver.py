# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import threading
from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.solver.hold_solver import HoldSolver, expand_compiled
from sphere_nmpc.solver.problem import SolverSettings, SolveStatus
from sphere_nmpc.solver.reference.objective import cost, expand
from sphere_nmpc.solver.roll_out import roll_out, roll_out_with_momentum

BACKENDS = ("compiled", "numpy")


def rest_start(problem):
    return np.zeros((problem.intervals, 2))


def random_start(problem, seed=1):
    return np.random.default_rng(seed).uniform(-100.0, 100.0, (problem.intervals, 2))


@pytest.mark.parametrize("seed", range(2))
def test_both_backends_take_the_same_steps(make_problem, kind, seed):
    problem = make_problem(kind, seed)
    # Few steps: rounding grows along the way where the problem is flat.
    settings = SolverSettings(max_iterations=8)
    ours, reference = (
        HoldSolver(settings, backend).solve(problem, random_start(problem)) for backend in BACKENDS
    )
    assert ours.iterations == reference.iterations
    assert ours.status is reference.status
    assert ours.cost == pytest.approx(reference.cost, rel=1e-9)
    assert np.max(np.abs(ours.inputs - reference.inputs)) < 1e-6
    assert ours.kkt_residual == pytest.approx(reference.kkt_residual, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
def test_solution_states_its_own_cost_states_and_residual(make_problem, kind, backend):
    problem = make_problem(kind)
    solution = HoldSolver(SolverSettings(max_iterations=15), backend).solve(
        problem, random_start(problem)
    )
    v = solution.inputs[1:].ravel() / problem.input_scale
    value, states = cost(problem, v)
    gradient, _ = expand(problem, v)
    low, high = (b.ravel() / problem.input_scale for b in (problem.lower, problem.upper))
    residual = np.max(np.abs(np.clip(v - gradient, low, high) - v))
    assert solution.cost == pytest.approx(value, rel=1e-9)
    assert np.allclose(solution.states, states, atol=1e-9)
    assert solution.kkt_residual == pytest.approx(residual, rel=1e-4, abs=1e-9)
    assert np.array_equal(solution.inputs[0], problem.input_in_force)
    assert solution.solve_time > 0.0


def test_converged_point_is_stationary_and_no_random_neighbour_is_better(make_problem):
    problem = make_problem("paper", unequal=False)
    solver = HoldSolver(SolverSettings(max_iterations=500, decrease_tolerance=1e-14))
    solution = solver.solve(problem, rest_start(problem))
    assert solution.status is SolveStatus.CONVERGED
    assert solution.kkt_residual < 1e-6
    rng = np.random.default_rng(0)
    v = solution.inputs[1:].ravel() / problem.input_scale
    for _ in range(50):
        near = np.clip(v + 1e-3 * rng.normal(size=v.size), -1.0, 1.0)
        assert cost(problem, near)[0] > solution.cost - 1e-9


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("scale", (100.0, 30.0, 7.0))
def test_bounds_hold_exactly(make_problem, kind, backend, scale):
    n = make_problem(kind).intervals
    bound = np.random.default_rng(2).uniform(1.0, 20.0, (n, 2)) / 3.0
    problem = make_problem(kind, lower=-bound, upper=2.0 * bound, input_scale=scale)
    solution = HoldSolver(SolverSettings(max_iterations=10), backend).solve(
        problem, random_start(problem)
    )
    assert np.all(solution.inputs[1:] >= problem.lower)
    assert np.all(solution.inputs[1:] <= problem.upper)
    active = (solution.inputs[1:] == problem.lower) | (solution.inputs[1:] == problem.upper)
    assert np.any(active), "the bounds have to be narrow enough to be active"


@pytest.mark.parametrize("backend", BACKENDS)
def test_fixed_knots_stay_where_they_are(make_problem, kind, backend):
    problem = make_problem(kind)
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[-1] = upper[-1] = 0.0
    lower[0, 1] = upper[0, 1] = 12.5
    problem = replace(problem, lower=lower, upper=upper)
    solution = HoldSolver(SolverSettings(max_iterations=10), backend).solve(
        problem, random_start(problem)
    )
    fixed = lower == upper
    assert np.array_equal(solution.inputs[1:][fixed], lower[fixed])
    assert (solution.iterations > 0) == (not fixed.all())


def test_problem_with_all_knots_fixed_converges(make_problem, kind):
    problem = make_problem(kind)
    problem = replace(problem, lower=np.zeros_like(problem.lower), upper=0.0 * problem.upper)
    for backend in BACKENDS:
        solution = HoldSolver(backend=backend).solve(problem, random_start(problem))
        assert solution.status is SolveStatus.CONVERGED
        assert solution.kkt_residual == 0.0
        assert not np.any(solution.inputs[1:])


def test_slew_penalty_limits_the_knot_differences(make_problem):
    problem = make_problem("slew", slew_weight=1e3, max_acceleration=60.0, unequal=False)
    free = HoldSolver().solve(replace(problem, slew_weight=0.0), random_start(problem))
    held = HoldSolver(SolverSettings(max_iterations=300)).solve(problem, random_start(problem))
    reach = problem.max_acceleration * problem.durations[:, None]
    beyond = [np.max(np.abs(np.diff(s.inputs, axis=0)) - reach) for s in (free, held)]
    assert beyond[0] > 10.0, "without the penalty the limit has to be exceeded"
    assert beyond[1] < 0.5


@pytest.mark.parametrize("backend", BACKENDS)
class TestStatus:
    def test_cap(self, make_problem, backend):
        problem = make_problem("paper")
        solution = HoldSolver(SolverSettings(max_iterations=2), backend).solve(
            problem, rest_start(problem)
        )
        assert solution.status is SolveStatus.CAPPED
        assert solution.iterations == 2

    def test_no_time(self, make_problem, backend):
        problem = make_problem("paper")
        solution = HoldSolver(SolverSettings(time_budget=0.0), backend).solve(
            problem, rest_start(problem)
        )
        assert solution.status is SolveStatus.BUDGET
        assert solution.iterations == 0
        assert np.isfinite(solution.cost)

    def test_not_finite(self, make_problem, backend):
        problem = make_problem("paper", state=np.full(6, np.nan))
        start = np.full((4, 2), 500.0)
        solution = HoldSolver(backend=backend).solve(problem, start)
        assert solution.status is SolveStatus.NOT_FINITE
        assert np.all(solution.inputs[1:] == 100.0), "the bounds hold whatever the status"

    def test_start_that_is_not_a_number(self, make_problem, backend):
        problem = make_problem("paper")
        solution = HoldSolver(backend=backend).solve(problem, np.full((4, 2), np.nan))
        assert solution.status is SolveStatus.NOT_FINITE

    @pytest.mark.parametrize("kind_of_hessian", ["paper", "terminal"])
    def test_gradient_that_is_not_a_number_in_one_component(
        self, make_problem, backend, kind_of_hessian
    ):
        # Twice the weight is infinite. Knots at zero have a gradient of inf times 0; the others
        # are at their lower bounds, and their part of the projected gradient is zero.
        problem = make_problem(kind_of_hessian, input_weight=1e308)
        lower = np.full_like(problem.lower, 10.0)
        lower[0, 0] = 0.0
        with np.errstate(invalid="ignore", over="ignore"):
            solution = HoldSolver(backend=backend).solve(
                replace(problem, lower=lower), rest_start(problem)
            )
        assert np.isfinite(solution.cost)
        assert np.isnan(solution.kkt_residual)
        assert solution.status is SolveStatus.NOT_FINITE

    def test_gradient_that_is_infinite_towards_a_bound(self, make_problem, backend):
        problem = make_problem("paper", input_weight=1e308)
        problem = replace(problem, lower=np.full_like(problem.lower, 10.0))
        with np.errstate(invalid="ignore", over="ignore"):
            solution = HoldSolver(backend=backend).solve(problem, rest_start(problem))
        assert np.isfinite(solution.cost)
        assert solution.status is SolveStatus.NOT_FINITE

    def test_no_finite_trial(self, make_problem, backend):
        # Cost and gradient are finite, the Hessian is not, so that no step can be computed.
        problem = make_problem("paper", input_in_force=np.zeros(2), input_scale=1e6)
        goal = problem.state + np.array([1e-6, 0.0, 0.0, 0.0, 0.0, 0.0])
        problem = replace(problem, goal=goal, terminal_weight=8e307)
        with np.errstate(invalid="ignore", over="ignore"):
            solution = HoldSolver(backend=backend).solve(problem, rest_start(problem))
        assert np.isfinite(solution.cost) and solution.kkt_residual > 0.0
        assert solution.iterations > 1
        assert solution.status is SolveStatus.STALLED
        assert not np.any(solution.inputs[1:])

    def test_no_step_lowers_the_cost_by_more_than_its_rounding(self, make_problem, backend):
        settings = SolverSettings(
            max_iterations=10_000, gradient_tolerance=0.0, decrease_tolerance=0.0
        )
        problem = make_problem("paper")
        solution = HoldSolver(settings, backend).solve(problem, rest_start(problem))
        assert 0.0 < solution.kkt_residual < 1e-6
        assert solution.status is SolveStatus.STALLED

    def test_target_reached_at_the_start(self, make_problem, backend):
        problem = make_problem("terminal")
        solution = HoldSolver(SolverSettings(target_cost=1e6), backend).solve(
            problem, rest_start(problem)
        )
        assert solution.status is SolveStatus.CONVERGED
        assert solution.iterations == 0

    def test_already_at_the_goal(self, make_problem, backend):
        problem = make_problem("paper", input_in_force=np.zeros(2))
        problem = replace(problem, goal=problem.state)
        solution = HoldSolver(backend=backend).solve(problem, rest_start(problem))
        assert solution.status is SolveStatus.CONVERGED
        assert solution.cost == 0.0

    def test_decrease_floor_stops_early(self, make_problem, backend):
        problem = make_problem("paper")
        early, late = (
            HoldSolver(SolverSettings(decrease_floor=floor), backend).solve(
                problem, rest_start(problem)
            )
            for floor in (1e-2, 0.0)
        )
        assert early.status is SolveStatus.CONVERGED
        assert early.iterations < late.iterations
        assert early.cost >= late.cost


def test_singular_model_without_input_weight_is_solved(make_problem):
    # 18 variables, 6 residuals and no input weight: only the damping makes the model definite.
    problem = make_problem("slew", input_weight=0.0, slew_weight=0.0)
    for backend in BACKENDS:
        solution = HoldSolver(SolverSettings(max_iterations=40), backend).solve(
            problem, random_start(problem)
        )
        assert np.isfinite(solution.cost)


def test_one_solver_serves_many_threads(make_problem):
    solver = HoldSolver(SolverSettings(max_iterations=20))
    problems = [make_problem("paper", seed) for seed in range(16)]
    alone = [solver.solve(problem, rest_start(problem)) for problem in problems]
    together = [None] * len(problems)

    def work(i):
        for _ in range(20):
            together[i] = solver.solve(problems[i], rest_start(problems[i]))

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(problems))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.inputs, other.inputs)


def test_later_solve_does_not_change_an_earlier_solution(make_problem):
    solver = HoldSolver()
    problem = make_problem("paper", 1)
    first = solver.solve(problem, rest_start(problem))
    kept = first.inputs.copy()
    other = make_problem("paper", 2)
    solver.solve(other, rest_start(other))
    assert np.array_equal(first.inputs, kept)


@pytest.mark.parametrize("backend", BACKENDS)
def test_momenta_are_those_along_the_solution(make_problem, kind, backend):
    problem = make_problem(kind)
    solution = HoldSolver(SolverSettings(max_iterations=8), backend).solve(
        problem, random_start(problem)
    )
    # Of the predicting function, which other tests compare with the integrator.
    expected = roll_out_with_momentum(
        problem.state, Drift.from_array(problem.drift), solution.inputs, problem.durations,
        problem.constants, problem.max_step,
    )[1]
    assert np.allclose(solution.momenta, expected, atol=1e-9)
    assert solution.momenta.any() == problem.drift.any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_inputs_that_nothing_else_determines_are_the_reference(make_problem, kind, backend):
    reference = np.array([12.0, -70.0])
    problem = make_problem(
        kind, input_reference=reference, input_weight=1.0, stage_weight=0.0, terminal_weight=0.0,
        slew_weight=0.0,
    )
    solution = HoldSolver(backend=backend).solve(problem, random_start(problem))
    assert np.allclose(solution.inputs[1:], reference, atol=1e-3)


@pytest.mark.parametrize("backend", BACKENDS)
def test_solve_with_drift_leaves_nothing_behind_for_one_without(make_problem, backend):
    """Both use the same memory."""
    problem = make_problem("drift")
    level = replace(problem, drift=np.zeros(8))
    fresh, used = HoldSolver(backend=backend), HoldSolver(backend=backend)
    expected = fresh.solve(level, random_start(problem))
    used.solve(problem, random_start(problem))
    found = used.solve(level, random_start(problem))
    assert np.array_equal(found.states, expected.states) and not found.momenta.any()


def test_drift_so_small_that_it_changes_nothing_gives_the_model_without(make_problem, kind):
    """The two models are computed by different functions."""
    problem = replace(make_problem(kind), drift=np.zeros(8), steady_interval=0, whole_turns=0.0)
    tiny = replace(problem, drift=np.array([1e-14, 0, 0, 0, 0, 0, 0, 0]))
    without, found = (expand_compiled(each, random_start(each)) for each in (problem, tiny))
    for name, value in without.items():
        scale = max(1.0, np.max(np.abs(value)))
        assert np.max(np.abs(found[name] - value)) < 1e-12 * scale, name


def test_pushed_sphere_reaches_an_upright_goal_with_rotors_that_hold_the_momentum(make_problem):
    n, pushed = 14, Drift(np.array([30.0, -20.0, 0.0]))
    goal = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    rest = pushed.rest_speeds(goal[2:])
    problem = make_problem(
        "terminal", intervals=n, durations=np.full(n, 0.25), goal=goal, input_weight=0.0,
        drift=pushed.as_array(), slew_weight=10.0, max_acceleration=400.0,
    )
    problem.lower[-1] = problem.upper[-1] = rest
    solver = HoldSolver(SolverSettings(max_iterations=300, target_cost=1e-12))
    found = min(
        (solver.solve(problem, random_start(problem, seed)) for seed in range(8)),
        key=lambda solution: solution.cost,
    )
    # Three times the square of the errors that the target cost allows.
    assert found.cost < 1e-11
    after = roll_out(found.states[-1], np.tile(rest, (3, 1)), np.ones(2), problem.constants,
                     drift=pushed)
    # At the target cost the orientation is off by up to 2e-6 rad, and the part of the momentum
    # that is not held, 36 rad/s times that, moves the sphere by less than 1e-5 in two seconds.
    assert np.max(np.abs(after - goal)) < 1e-4


def test_unknown_backend_is_refused():
    with pytest.raises(InvalidParameterError, match="backend: given 'gpu'"):
        HoldSolver(backend="gpu")
