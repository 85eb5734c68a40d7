# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper: problem, cost and warm start as printed, and stationary points."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from motions import integrate
from sampled_loop import settling_time

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, make_state, without_momentum
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.plain import expand
from sphere_nmpc.solver.problem import LeastSquaresProblem, Solution, SolverSettings
from sphere_nmpc.solver.solve import solve
from sphere_nmpc.strategy import paper
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.paper import PaperStrategy, loops
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
    return Situation(time, without_momentum(start), PAPER_CASES[case].goal, in_force, ROBOT.lumped)


@pytest.fixture
def strategy() -> PaperStrategy:
    return PaperStrategy(SETTINGS, ROBOT)


@pytest.mark.parametrize(
    ("case", "alpha", "beta"), [(1, 0.5, 1e8), (2, 3.0, 1e5), (3, 3.0, 1e5), (4, 0.5, 1e8)]
)
def test_cost_agrees_with_eq_24_worked_out_from_the_plan(
    case: int, alpha: float, beta: float
) -> None:
    settings = ControllerSettings(strategy="paper", input_weight=alpha, terminal_weight=beta)
    plan = PaperStrategy(settings, ROBOT).plan(situation(case=case))
    misses = plan.states[:, POSE] - PAPER_CASES[case].goal
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


@pytest.mark.parametrize("left", [1e-5, 0.1])
def test_short_first_interval_keeps_the_limit_of_acceleration(
    strategy: PaperStrategy, left: float
) -> None:
    strategy.plan(situation())
    in_force = np.array([-95.0, 40.0])
    plan = strategy.plan(situation(T - left, in_force=in_force))
    change = np.abs(plan.hold.speeds[1] - in_force)
    assert np.all(change <= ROBOT.max_rotor_acceleration * left * (1.0 + 1e-6))
    assert np.max(np.abs(plan.hold.speeds)) <= ROBOT.max_rotor_speed


def test_state_at_the_goal_leads_to_no_motion(strategy: PaperStrategy) -> None:
    plan = strategy.plan(situation(state=PAPER_CASES[1].goal))
    np.testing.assert_allclose(plan.hold.speeds, 0.0, atol=1e-9)
    assert plan.cost == pytest.approx(0.0, abs=1e-12)


def test_initial_guess_is_zero_at_first_and_then_the_shifted_plan_with_zeros(
    strategy: PaperStrategy, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = (SETTINGS.horizon, SETTINGS.period, SETTINGS.alpha, SETTINGS.terminal_weight)
    assert numbers == (N, T, 0.5, 1e8), "of section 4"
    calls: list[Any] = []

    def recorded(problem: LeastSquaresProblem, start: Vector, *others: Any) -> Solution:
        calls.append((problem, start.copy()))
        return solve(problem, start, *others)

    monkeypatch.setattr(paper, "solve", recorded)
    plan = strategy.plan(situation())
    assert plan.status is PlanStatus.SOLVED
    np.testing.assert_allclose(plan.hold.times, T * np.arange(N + 1))
    state, p = PAPER_CASES[1].start, ROBOT.lumped.as_array()
    for m in range(N):
        np.testing.assert_allclose(plan.states[m, POSE], state, atol=1e-12)
        state = integrate(state, plan.hold.speeds[m], plan.hold.speeds[m + 1], T, p)
    np.testing.assert_allclose(plan.states[N, POSE], state, atol=1e-12)
    second = strategy.plan(situation(T, plan.states[1], plan.hold.speeds[1]))
    strategy.plan(situation(3 * T, second.states[2], second.hold.speeds[2]))  # one is missed
    strategy.reset()
    after = strategy.plan(situation(0.2))
    np.testing.assert_allclose(after.hold.times, 0.2 + T * np.arange(N + 1))
    expected = (
        np.zeros((N, 2)), np.vstack((plan.hold.speeds[2:], REST)),
        np.vstack((second.hold.speeds[3:], REST, REST)), np.zeros((N, 2)),
    )
    for (_, start), wanted in zip(calls, expected, strict=True):
        np.testing.assert_allclose(start, wanted, atol=1e-12)
    np.testing.assert_array_equal(calls[0][0].goal, PAPER_CASES[1].goal)


def test_plan_of_a_solve_that_was_stopped_is_the_best_so_far(strategy: PaperStrategy) -> None:
    hurried = strategy.plan(replace(situation(), time_budget=1e-9))
    assert hurried.status is PlanStatus.BEST_SO_FAR
    assert np.all(np.isfinite(hurried.hold.speeds))
    assert strategy.plan(situation()).status is PlanStatus.SOLVED
    strategy.reset()
    # Neither tolerance can be met, so that the solve ends where no step lowers the cost.
    never = SolverSettings(10_000, gradient_tolerance=0.0, decrease_tolerance=0.0)
    strategy._solver_settings = never
    plan = strategy.plan(situation())
    assert plan.status is PlanStatus.BEST_SO_FAR
    assert plan.message == "no step lowers the cost"


STARTS = {
    "upright": (1.0, 0.0, 0.0, 0.0),
    "upside down": (0.0, 1.0, 0.0, 0.0),
    "on its side": (0.5**0.5, 0.0, 0.5**0.5, 0.0),
    "on the circle": (0.5, 0.5, 0.5, 0.5),
}


def turned(degrees: float) -> Vector:
    half = 0.5 * np.radians(degrees)
    return np.array([np.cos(half), 0.0, 0.0, np.sin(half)])


def typed(position: tuple[float, float], heading: float) -> Situation:
    """Return the situation of an upright start and a goal with round numbers."""
    start, goal = make_state((0.0, 0.0), STARTS["upright"]), make_state(position, turned(heading))
    return Situation(0.0, without_momentum(start), goal, np.zeros(2), ROBOT.lumped)


# With rest as the only initial guess, most of these stopped up to 1.7 away from the goal.
@pytest.mark.parametrize(
    ("name", "start", "position", "heading"),
    [
        ("paper", "upright", (1.0, 0.0), 0.0),
        ("plan_keeping", "upright", (0.1, 0.1), 0.0),
        ("plan_keeping", "upright", (0.0, 0.0), 90.0),
        ("paper", "upright", (0.0, 0.0), 180.0),
        ("plan_keeping", "upside down", (0.0, 0.0), 0.0),
        ("paper", "upside down", (-1.0, 1.0), 90.0),
        ("paper", "on the circle", (0.0, -5.0), -90.0),
    ],
)
def test_goal_with_round_numbers_is_reached_within_a_minute(name, start, position, heading):
    begin = make_state((0.0, 0.0), STARTS[start])
    assert settling_time(name, begin, make_state(position, turned(heading)), 62.0) < 60.0


def test_rest_is_a_stationary_point_of_a_turn_on_the_spot_but_no_minimum(strategy) -> None:
    problem = strategy._problem(typed((0.0, 0.0), 90.0), T * np.arange(N + 1))
    at_rest = expand(problem, np.zeros(2 * N))
    # The gradient is zero but for rounding of the states, of order one.
    assert np.max(np.abs(at_rest.gradient)) < 1e-12
    for guess in loops(problem):
        assert solve(problem, guess, SolverSettings()).cost < 0.1 * at_rest.cost
    assert all(np.all(np.abs(guess) <= problem.input_scale) for guess in loops(problem))
    late = replace(typed((0.0, 0.0), 90.0), time_budget=0.0)
    assert not strategy.plan(late).hold.speeds.any(), "no time for further guesses"
