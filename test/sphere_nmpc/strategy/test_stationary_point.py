# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stationary points short of the goal: they are recognised and left."""

from dataclasses import replace

import numpy as np
import pytest
from plan_loop import settling_time

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, make_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.hold_solver import HoldSolver, expand_compiled
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.stationary_point import NO_PROGRESS, SETTLED_COST, Descent, loops

STRATEGIES = ("paper", "plan_keeping")
ROBOT = RobotParameters()
HALF = np.sqrt(0.5)
STARTS = {
    "upright": (1.0, 0.0, 0.0, 0.0),
    "upside down": (0.0, 1.0, 0.0, 0.0),
    "on its side": (HALF, 0.0, HALF, 0.0),
    "on the circle": (0.5, 0.5, 0.5, 0.5),
}


def turned(degrees: float) -> Vector:
    half = 0.5 * np.radians(degrees)
    return np.array([np.cos(half), 0.0, 0.0, np.sin(half)])


def situation(position: tuple[float, float], heading: float) -> Situation:
    start, goal = make_state((0.0, 0.0), STARTS["upright"]), make_state(position, turned(heading))
    return Situation(0.0, start, goal, np.zeros(2), ROBOT.lumped)


# With rest as the only initial guess, most of these stopped up to 1.7 away from the goal.
@pytest.mark.parametrize(
    ("start", "position", "heading"),
    [
        ("upright", (1.0, 0.0), 0.0),
        ("upright", (0.1, 0.1), 0.0),
        ("upright", (-2.0, 0.0), 0.0),
        ("upright", (10.0, 0.0), 0.0),
        ("upright", (0.0, 0.0), 15.0),
        ("upright", (0.0, 0.0), 90.0),
        ("upright", (0.0, 0.0), 180.0),
        ("upside down", (0.0, 0.0), 0.0),
        ("upside down", (-1.0, 1.0), 90.0),
        ("on its side", (0.0, 0.0), 0.0),
        ("on its side", (1.0, 0.0), 0.0),
        ("on the circle", (0.0, -5.0), -90.0),
    ],
)
@pytest.mark.parametrize("name", STRATEGIES)
def test_goal_with_round_numbers_is_reached_within_a_minute(name, start, position, heading):
    begin = make_state((0.0, 0.0), STARTS[start])
    assert settling_time(name, begin, make_state(position, turned(heading)), 75.0) < 60.0


def test_rest_is_a_stationary_point_of_a_turn_on_the_spot_but_no_minimum() -> None:
    strategy = PaperStrategy(ControllerSettings(strategy="paper"), ROBOT)
    problem = strategy._problem(situation((0.0, 0.0), 90.0), 0.5 * np.arange(5))
    at_rest = expand_compiled(problem, np.zeros((4, 2)))
    # The gradient is zero but for rounding of the states, of order one.
    assert np.max(np.abs(at_rest["gradient"])) < 1e-12
    for guess in loops(problem):
        assert HoldSolver().solve(problem, guess).cost < 0.1 * at_rest["cost"]


def test_no_other_guess_is_tried_where_the_plan_makes_progress() -> None:
    begin = make_state((0.0, 0.0), np.array([0.8, 0.36, 0.48, 0.0]))
    away = replace(situation((2.0, 1.0), 70.0), state=begin)
    strategy = PaperStrategy(ControllerSettings(strategy="paper"), ROBOT)
    problem = strategy._problem(away, 0.5 * np.arange(5))
    from_rest = HoldSolver().solve(problem, np.zeros((4, 2)))
    np.testing.assert_array_equal(strategy.plan(away).hold.speeds, from_rest.inputs)


def test_stationary_point_that_no_guess_improves_says_so(monkeypatch) -> None:
    monkeypatch.setattr("sphere_nmpc.strategy.paper.loops", lambda problem: [])
    strategy = PaperStrategy(ControllerSettings(strategy="paper"), ROBOT)
    assert strategy.plan(situation((0.0, 0.0), 90.0)).message == NO_PROGRESS
    strategy.reset()
    assert strategy.plan(situation((0.5, 0.2), 40.0)).message == "converged"


def test_further_guesses_stop_at_the_time_budget() -> None:
    strategy = PaperStrategy(ControllerSettings(strategy="paper"), ROBOT)
    plan = strategy.plan(replace(situation((0.0, 0.0), 90.0), time_budget=0.0))
    assert not plan.hold.speeds.any()


@pytest.mark.parametrize("kind", ["paper", "one interval"])
def test_no_loop_is_the_mirror_image_of_itself_or_another_one(make_problem, kind) -> None:
    problem = make_problem(kind)
    guesses = loops(problem)
    assert all(guess.shape == (problem.intervals, 2) for guess in guesses)
    for guess in guesses:
        assert np.all(np.abs(guess) <= problem.input_scale)
        # Across the plane of either rotor, and across the one between them.
        for mirrored in (guess * [1.0, -1.0], guess * [-1.0, 1.0], guess[:, ::-1]):
            assert kind == "one interval" or not np.allclose(guess, mirrored)


def test_progress_ends_where_the_cost_stays_from_one_period_to_the_next(make_problem) -> None:
    solution = HoldSolver().solve(make_problem("paper"), np.zeros((4, 2)))
    assert solution.cost > SETTLED_COST
    progress = Descent(SETTLED_COST)
    assert not progress.has_ended(2.0, solution)
    assert not progress.has_ended(2.0, solution)  # solved again before the next knot
    assert progress.has_ended(2.5, solution)
    solution.cost *= 0.99
    assert not progress.has_ended(3.0, solution)
    solution.iterations = 0
    assert progress.has_ended(3.5, solution)


def test_progress_ends_nowhere_within_the_settled_cost(make_problem) -> None:
    solution = HoldSolver().solve(make_problem("paper"), np.zeros((4, 2)))
    progress = Descent(settled_cost=solution.cost)
    assert not progress.has_ended(2.0, solution)
    assert not progress.has_ended(2.5, solution)
