# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper: problem, cost and warm start as printed."""

import numpy as np
import pytest

from sphere_nmpc.model.integrator import integrate
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import Vector, flipped_sign
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_sim.scenario.scenarios import PAPER_CASES

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="paper")
T, N = 0.5, 4
REST = np.zeros(2)


def situation(
    time: float = 0.0, state: Vector | None = None, in_force: Vector = REST, case: int = 1
) -> Situation:
    start = PAPER_CASES[case].start if state is None else state
    return Situation(time, start, PAPER_CASES[case].goal, in_force, ROBOT.lumped)


class RecordingSolver:
    """Solver that records its problems and initial guesses."""

    def __init__(self, strategy: PaperStrategy) -> None:
        self._solver = strategy._solver
        self.settings = self._solver.settings
        strategy._solver = self  # type: ignore[assignment]
        self.problems: list[HoldProblem] = []
        self.starts: list[Vector] = []

    def solve(
        self, problem: HoldProblem, start: Vector, time_budget: float | None = None
    ) -> HoldSolution:
        self.problems.append(problem)
        self.starts.append(start.copy())
        return self._solver.solve(problem, start, time_budget)


@pytest.fixture
def strategy() -> PaperStrategy:
    return PaperStrategy(SETTINGS, ROBOT)


def test_settings_default_to_the_numbers_of_section_4() -> None:
    numbers = (SETTINGS.horizon, SETTINGS.period, SETTINGS.terminal_weight)
    assert numbers == (4, 0.5, 1e8)
    assert SETTINGS.alpha == 0.5
    assert SETTINGS.control_period == 0.5


def test_plan_starts_at_the_input_in_force_and_has_a_knot_every_period(
    strategy: PaperStrategy,
) -> None:
    in_force = np.array([10.0, -20.0])
    plan = strategy.plan(situation(3.0, in_force=in_force))
    assert plan.status is PlanStatus.SOLVED
    np.testing.assert_allclose(plan.hold.times, 3.0 + T * np.arange(N + 1))
    np.testing.assert_array_equal(plan.hold.speeds[0], in_force)
    assert np.max(np.abs(plan.hold.speeds)) <= ROBOT.max_rotor_speed


def test_states_of_the_plan_are_those_its_speeds_lead_to(strategy: PaperStrategy) -> None:
    plan = strategy.plan(situation())
    state, p = PAPER_CASES[1].start, ROBOT.lumped.as_array()
    for m in range(N):
        np.testing.assert_allclose(plan.states[m], state, atol=1e-12)
        state = integrate(state, plan.hold.speeds[m], plan.hold.speeds[m + 1], T, p)
    np.testing.assert_allclose(plan.states[N], state, atol=1e-12)


@pytest.mark.parametrize("case", [1, 2, 3, 4])
@pytest.mark.parametrize("weights", [(0.5, 1e8), (3.0, 1e5)])
def test_cost_agrees_with_eq_24_worked_out_from_the_plan(
    case: int, weights: tuple[float, float]
) -> None:
    alpha, beta = weights
    settings = ControllerSettings(strategy="paper", input_weight=alpha, terminal_weight=beta)
    plan = PaperStrategy(settings, ROBOT).plan(situation(case=case))
    misses = plan.states - PAPER_CASES[case].goal
    expected = 0.0
    for m in range(N):
        expected += float(misses[m] @ misses[m])
        expected += alpha * float(plan.hold.speeds[m + 1] @ plan.hold.speeds[m + 1])
    expected += beta * float(misses[N] @ misses[N])
    # Rounding of a sum of a few terms.
    assert plan.cost == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("case", [1, 3])
def test_plan_is_a_local_minimum_of_eq_24(case: int) -> None:
    plan = PaperStrategy(SETTINGS, ROBOT).plan(situation(case=case))
    start, goal = PAPER_CASES[case].start, PAPER_CASES[case].goal
    p, knots = ROBOT.lumped.as_array(), plan.hold.speeds

    def cost(speeds: Vector) -> float:
        state, value = start, 0.0
        for m in range(N):
            value += float(np.sum((state - goal) ** 2) + 0.5 * np.sum(speeds[m + 1] ** 2))
            state = integrate(state, speeds[m], speeds[m + 1], T, p)
        return value + 1e8 * float(np.sum((state - goal) ** 2))

    best = cost(knots)
    rng = np.random.default_rng(0)
    for _ in range(30):
        nearby = knots + np.vstack((REST, rng.normal(scale=0.3, size=(N, 2))))
        # A decrease of 1e-9 of the cost is where the solver stops; curvature hides no more.
        assert cost(np.clip(nearby, -100.0, 100.0)) > best * (1.0 - 1e-5)


def test_initial_guess_is_zero_at_first_and_then_the_shifted_plan_with_a_zero(
    strategy: PaperStrategy,
) -> None:
    recorded = RecordingSolver(strategy)
    first = strategy.plan(situation())
    np.testing.assert_array_equal(recorded.starts[0], np.zeros((N, 2)))
    strategy.plan(situation(T, first.states[1], first.hold.speeds[1]))
    expected = np.vstack((first.hold.speeds[2:], REST))
    np.testing.assert_allclose(recorded.starts[1], expected, atol=1e-12)


def test_missed_sample_shifts_the_initial_guess_by_two(strategy: PaperStrategy) -> None:
    recorded = RecordingSolver(strategy)
    first = strategy.plan(situation())
    strategy.plan(situation(2 * T, first.states[2], first.hold.speeds[2]))
    expected = np.vstack((first.hold.speeds[3:], REST, REST))
    np.testing.assert_allclose(recorded.starts[1], expected, atol=1e-12)


def test_reset_forgets_the_plan_and_the_grid_of_knots(strategy: PaperStrategy) -> None:
    recorded = RecordingSolver(strategy)
    strategy.plan(situation())
    strategy.reset()
    plan = strategy.plan(situation(0.2))
    np.testing.assert_array_equal(recorded.starts[1], np.zeros((N, 2)))
    np.testing.assert_allclose(plan.hold.times, 0.2 + T * np.arange(N + 1))


def test_solve_between_two_knots_shortens_the_first_interval_alone(
    strategy: PaperStrategy,
) -> None:
    recorded = RecordingSolver(strategy)
    first = strategy.plan(situation())
    second = strategy.plan(situation(0.05, in_force=first.hold.at(0.05)))
    np.testing.assert_allclose(second.hold.times, [0.05, 0.5, 1.0, 1.5, 2.0])
    np.testing.assert_allclose(recorded.starts[1], first.hold.speeds[1:], atol=1e-12)
    later = strategy.plan(situation(0.5 - 1e-9, in_force=first.hold.at(0.5)))
    np.testing.assert_allclose(later.hold.times[1:], [1.0, 1.5, 2.0, 2.5])


@pytest.mark.parametrize("left", [1e-5, 0.01, 0.1, 0.25])
def test_short_first_interval_keeps_the_limit_of_acceleration(
    strategy: PaperStrategy, left: float
) -> None:
    strategy.plan(situation())
    in_force = np.array([-95.0, 40.0])
    plan = strategy.plan(situation(T - left, in_force=in_force))
    change = np.abs(plan.hold.speeds[1] - in_force)
    assert np.all(change <= ROBOT.max_rotor_acceleration * left * (1.0 + 1e-6))
    assert np.max(np.abs(plan.hold.speeds)) <= ROBOT.max_rotor_speed


def test_goal_is_aimed_at_with_the_sign_that_was_given(strategy: PaperStrategy) -> None:
    recorded = RecordingSolver(strategy)
    given = situation()
    flipped = Situation(0.0, given.state, flipped_sign(given.goal), REST, ROBOT.lumped)
    strategy.plan(flipped)
    np.testing.assert_array_equal(recorded.problems[0].goal, flipped.goal)


def test_state_at_the_goal_leads_to_no_motion(strategy: PaperStrategy) -> None:
    plan = strategy.plan(situation(state=PAPER_CASES[1].goal))
    np.testing.assert_allclose(plan.hold.speeds, 0.0, atol=1e-9)
    assert plan.cost == pytest.approx(0.0, abs=1e-12)


def test_plan_at_the_cap_of_iterations_is_the_best_so_far() -> None:
    settings = ControllerSettings(strategy="paper", max_iterations=2)
    plan = PaperStrategy(settings, ROBOT).plan(situation())
    assert plan.status is PlanStatus.BEST_SO_FAR
    assert plan.iterations <= 2


def test_plan_that_ran_out_of_time_is_the_best_so_far(strategy: PaperStrategy) -> None:
    given = situation()
    hurried = Situation(0.0, given.state, given.goal, REST, ROBOT.lumped, time_budget=1e-9)
    plan = strategy.plan(hurried)
    assert plan.status is PlanStatus.BEST_SO_FAR
    assert np.all(np.isfinite(plan.hold.speeds))
    assert strategy.plan(given).status is PlanStatus.SOLVED


def test_plan_of_a_solve_that_has_stalled_is_the_best_so_far(strategy: PaperStrategy) -> None:
    # Neither tolerance can be met, so that the solve ends where no step lowers the cost.
    never = SolverSettings(10_000, gradient_tolerance=0.0, decrease_tolerance=0.0)
    strategy._solver = HoldSolver(never)
    plan = strategy.plan(situation())
    assert plan.status is PlanStatus.BEST_SO_FAR
    assert plan.message == "no step lowers the cost"


def test_model_without_numbers_is_an_error_that_the_loop_catches(
    strategy: PaperStrategy,
) -> None:
    nothing = LumpedConstants(float("nan"), 0.01, 0.7, 0.7)
    given = situation()
    with pytest.raises(ArithmeticError, match="finite"):
        strategy.plan(Situation(0.0, given.state, given.goal, REST, nothing))
