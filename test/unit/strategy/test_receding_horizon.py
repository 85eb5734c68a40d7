# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper as printed and `plan_keeping`; changes, kept plans, goals reached."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from motions import integrate
from sampled_loop import settling_time
from solver_problems import make_problem

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import exponential
from sphere_nmpc.model.state import POSE, Vector, flipped_sign, make_state, without_momentum
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.solver.plain import expand
from sphere_nmpc.solver.problem import LeastSquaresProblem, Solution, SolverSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.solver.solve import solve
from sphere_nmpc.strategy import paper
from sphere_nmpc.strategy.contract import Situation, Strategy, make_strategy
from sphere_nmpc.strategy.paper import PaperStrategy, loops
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.plan_keeping import (
    PLAN_KEEPING,
    plan_keeping_settings,
    solve_both_signs,
)
from sphere_sim.scenario.scenarios import PAPER_CASES

ROBOT = RobotParameters()
P = ROBOT.lumped.as_array()
SETTINGS = ControllerSettings(strategy="paper")
T, N = 0.5, 4
REST = np.zeros(2)


def situation(
    time: float = 0.0, state: Vector | None = None, in_force: Vector = REST, case: int = 1
) -> Situation:
    start = PAPER_CASES[case].start if state is None else state
    goal = PAPER_CASES[case].goal
    return Situation.of(time, without_momentum(start), goal, in_force, ROBOT.lumped)


@pytest.fixture
def strategy() -> PaperStrategy:
    return PaperStrategy(SETTINGS, ROBOT)


def followed(settings: ControllerSettings) -> tuple[Strategy, Situation]:
    """Return a strategy with a plan that was followed exactly, and the situation a sample later.
    """
    made = make_strategy(settings, ROBOT)
    plan = made.plan(situation())
    knot = int(np.argmin(np.abs(plan.hold.times - settings.period)))
    return made, situation(settings.period, plan.states[knot], plan.hold.speeds[knot])


def rolled(start: Vector, knots: Vector) -> Vector:
    """Return the states at the knots of a plan, integrated by the CasADi model."""
    states = [start]
    for before, after in pairwise(knots):
        states.append(integrate(states[-1], before, after, T, P))
    return np.array(states)


@pytest.mark.parametrize(
    ("case", "alpha", "beta"), [(1, 0.5, 1e8), (2, 3.0, 1e5), (3, 3.0, 1e5), (4, 0.5, 1e8)]
)
def test_plan_is_a_local_minimum_of_eq_24(case: int, alpha: float, beta: float) -> None:
    settings = ControllerSettings(strategy="paper", input_weight=alpha, terminal_weight=beta)
    plan = PaperStrategy(settings, ROBOT).plan(situation(case=case))

    def cost(states: Vector, knots: Vector) -> float:
        misses = np.sum((states - PAPER_CASES[case].goal) ** 2, axis=1)
        return float(np.sum(misses[:N]) + alpha * np.sum(knots[1:] ** 2) + beta * misses[N])

    states, knots, rng = plan.states[:, POSE], plan.hold.speeds, np.random.default_rng(0)
    # Rounding of a sum of a few terms.
    assert plan.made.cost == pytest.approx(cost(states, knots), rel=1e-12)
    np.testing.assert_allclose(states, rolled(PAPER_CASES[case].start, knots), atol=1e-12)
    for _ in range(30):
        near = knots + np.vstack((REST, rng.normal(scale=0.3, size=(N, 2))))
        near[1:] = np.clip(near[1:], -100.0, 100.0)
        # A decrease of 1e-9 of the cost is where the solver stops; curvature hides no more.
        assert cost(rolled(states[0], near), near) > plan.made.cost * (1.0 - 1e-5)


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
    assert plan.made.cost == pytest.approx(0.0, abs=1e-12)


def test_initial_guess_is_zero_at_first_and_then_the_shifted_plan_with_zeros(
    strategy: PaperStrategy, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = (SETTINGS.horizon, SETTINGS.period, SETTINGS.alpha, SETTINGS.terminal_weight)
    assert numbers == (N, T, 0.5, 1e8), "of section 4"
    starts, goals = list[Vector](), list[Vector]()

    def recorded(problem: LeastSquaresProblem, start: Vector, *others: Any) -> Solution:
        starts.append(start.copy())
        goals.append(problem.goal)
        return solve(problem, start, *others)

    monkeypatch.setattr(paper, "solve", recorded)
    plan = strategy.plan(situation())
    assert plan.status is PlanStatus.SOLVED
    np.testing.assert_allclose(plan.hold.times, T * np.arange(N + 1))
    second = strategy.plan(situation(T, plan.states[1], plan.hold.speeds[1]))
    strategy.plan(situation(3 * T, second.states[2], second.hold.speeds[2]))  # one is missed
    strategy.reset()
    after = strategy.plan(situation(0.2))
    np.testing.assert_allclose(after.hold.times, 0.2 + T * np.arange(N + 1))
    expected = (
        np.zeros((N, 2)), np.vstack((plan.hold.speeds[2:], REST)),
        np.vstack((second.hold.speeds[3:], REST, REST)), np.zeros((N, 2)),
    )
    for start, wanted in zip(starts, expected, strict=True):
        np.testing.assert_allclose(start, wanted, atol=1e-12)
    np.testing.assert_array_equal(goals[0], PAPER_CASES[1].goal)


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


@pytest.mark.parametrize("name", STRATEGIES)
def test_plan_that_is_followed_survives_a_change(name: str) -> None:
    settings = ControllerSettings(strategy=name)
    (changed, second), (unchanged, _) = followed(settings), followed(settings)
    assert f"{type(changed).__module__}:{type(changed).__name__}" == STRATEGIES[name].path
    changed.change(replace(settings, goal_tolerance=0.02))
    found, expected = changed.plan(second), unchanged.plan(second)
    np.testing.assert_array_equal(found.hold.speeds, expected.hold.speeds)
    # A strategy without that plan finds another one.
    fresh = make_strategy(settings, ROBOT).plan(second)
    assert not np.array_equal(fresh.hold.speeds, expected.hold.speeds)


@pytest.mark.parametrize("name", ["plan_keeping", "paper"])
def test_changed_cap_on_iterations_and_weight_hold_from_the_next_plan_on(name: str) -> None:
    settings = ControllerSettings(strategy=name)
    made, second = followed(settings)
    assert made.plan(second).made.iterations > 1
    made.change(replace(settings, max_iterations=1))
    assert made.plan(second).made.iterations == 1
    made.change(replace(settings, input_weight=1e6))
    assert np.max(np.abs(made.plan(second).hold.speeds[1:])) < 1.0


def turned(x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> Vector:
    """Return an upright pose with its heading in degrees."""
    return make_state((x, y), exponential(np.array([0.0, 0.0, np.radians(heading)])))


UPRIGHT = turned()
UPSIDE_DOWN = make_state((0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
ON_THE_CIRCLE = make_state((0.0, 0.0), (0.5, 0.5, 0.5, 0.5))


@pytest.mark.parametrize(
    ("name", "start", "goal", "latest"),
    [
        # Algorithm 1 takes 12.3, 12.5, 6.6 and 8.7 s. Rounding decides which local minimum is
        # found, with a difference of a second: 7.4 to 8.6, 6.4 to 8.1, 2.6 and 3.0 s were seen.
        *(("plan_keeping", PAPER_CASES[case].start, PAPER_CASES[case].goal, latest)
          for case, latest in ((1, 9.5), (2, 9.0), (3, 3.5), (4, 4.0))),
        # With rest as the only initial guess, most of these stopped up to 1.7 away from the goal.
        ("paper", UPRIGHT, turned(1.0), 60.0),
        ("plan_keeping", UPRIGHT, turned(0.1, 0.1), 60.0),
        ("plan_keeping", UPRIGHT, turned(heading=90.0), 60.0),
        ("paper", UPRIGHT, turned(heading=180.0), 60.0),
        ("plan_keeping", UPSIDE_DOWN, turned(), 60.0),
        ("paper", UPSIDE_DOWN, turned(-1.0, 1.0, 90.0), 60.0),
        ("paper", ON_THE_CIRCLE, turned(0.0, -5.0, -90.0), 60.0),
    ],
)
def test_goal_is_reached_in_time(name, start, goal, latest) -> None:
    assert settling_time(name, start, goal, latest + 2.5) <= latest


def test_rest_is_a_stationary_point_of_a_turn_on_the_spot_but_no_minimum(strategy) -> None:
    turn = Situation.of(0.0, without_momentum(UPRIGHT), turned(heading=90.0), REST, ROBOT.lumped)
    problem = strategy._problem(turn, T * np.arange(N + 1))
    at_rest = expand(problem, np.zeros(2 * N))
    # The gradient is zero but for rounding of the states, of order one.
    assert np.max(np.abs(at_rest.gradient)) < 1e-12
    for guess in loops(problem):
        assert np.all(np.abs(guess) <= problem.input_scale)
        assert solve(problem, guess, SolverSettings()).cost < 0.1 * at_rest.cost
    late = replace(turn, time_budget=0.0)
    assert not strategy.plan(late).hold.speeds.any(), "no time for further guesses"


def test_each_solution_aims_at_its_own_sign() -> None:
    problem, settings = make_problem("paper", 1), plan_keeping_settings()
    rest = (np.zeros((4, 2)), np.zeros((4, 2)))
    answer = solve_both_signs(settings, problem, rest, 0)
    other = replace(problem, goal=flipped_sign(problem.goal))
    mirrored = solve_both_signs(settings, other, rest, 1)
    # The same two problems, and the followed one is the same in both.
    for sign in (0, 1):
        assert np.array_equal(answer.inputs_for(sign), mirrored.inputs_for(1 - sign))


def test_plan_that_reaches_the_goal_is_kept() -> None:
    """It is not replaced by one with smaller inputs that reaches the goal later."""
    problem = make_problem("paper", 2, unequal=False)
    start = np.random.default_rng(0).uniform(-80.0, 80.0, (4, 2))
    inputs = np.vstack((problem.input_in_force, start))
    end = roll_out(problem.state, inputs, problem.durations, problem.constants)[-1]
    kept = solve(replace(problem, goal=end[POSE]), start, PLAN_KEEPING)
    assert np.max(np.abs(kept.inputs[1:] - start)) < 5.0
    assert np.linalg.norm(kept.states[-1] - end) < 1e-2
