# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Far goals: the work of a sample is independent of the distance, and the path is straight."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import FARTHEST, POSITION, Vector, make_state
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.initial_guesses import cruise_speed
from sphere_nmpc.strategy.time_optimal.intermediate_goals import IntermediateGoals
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import settling_index, state_errors
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
TUNING = TimeOptimalSettings()
FAR, FAR_IN_TIME = TUNING.far_distance, TUNING.far_distance_in_time
STEP = TUNING.intermediate_distance
START = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
TOP_SPEED = cruise_speed(ROBOT.lumped, ROBOT.max_rotor_speed)
DIRECTION = np.array([0.8, 0.6])


def goal_at(distance: float) -> Vector:
    return make_state(distance * DIRECTION, (np.cos(0.3), 0.0, 0.0, np.sin(0.3)))


def run(strategy: str, distance: float, duration: float) -> Trajectory:
    settings = ControllerSettings(strategy=strategy)
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(START)), ROBOT, make_plant("rolling", ROBOT, START)
    )
    controller = Controller(settings, ROBOT)
    period = settings.control_period
    trajectory = run_closed_loop(simulator, controller, goal_at(distance), duration, period)
    assert controller.failures == 0
    return trajectory


def situation(place: Vector, goal: Vector) -> Situation:
    return Situation(0.0, make_state(place, START[2:]), goal, np.zeros(2), ROBOT.lumped)


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("distance", [1e2, 1e5, 0.999 * FARTHEST])
def test_path_is_straight_from_the_start_at_every_distance(strategy, distance) -> None:
    duration = 8.0
    trajectory = run(strategy, distance, duration)
    along = float(trajectory.states[-1][POSITION] @ DIRECTION)
    aside = np.abs(trajectory.states[:, POSITION] @ np.array([-0.6, 0.8]))
    assert along > 0.5 * duration * TOP_SPEED
    assert np.max(aside) < 1.0
    # Time integrated at each sample; without intermediate goals it is minutes to days.
    longest = max(d.plan.hold.end - d.plan.hold.start for d in trajectory.decisions)
    assert longest < 3.0 * STEP / TOP_SPEED


@pytest.mark.slow
def test_far_goal_is_reached_at_top_speed() -> None:
    distance = 1.5 * FAR
    trajectory = run("time_optimal", distance, distance / TOP_SPEED + 15.0)
    errors = state_errors(trajectory.states, goal_at(distance))
    index = settling_index(errors, 1e-2)
    assert index is not None
    assert trajectory.times[index] < 1.05 * distance / TOP_SPEED + 5.0
    # It does not slow down for intermediate goals.
    cruise = (trajectory.times > 10.0) & (trajectory.times < 0.75 * distance / TOP_SPEED)
    fastest = np.max(np.abs(trajectory.speeds[cruise]), axis=1)
    assert np.mean(fastest > 0.9 * ROBOT.max_rotor_speed) > 0.95


def test_near_goal_is_aimed_at_itself() -> None:
    near = situation(np.zeros(2), goal_at(0.99 * FAR))
    assert IntermediateGoals(TUNING).aim(near, 0.0) == (near, False, False)


def test_with_limited_time_intermediate_goals_begin_at_a_shorter_distance() -> None:
    limited = replace(situation(np.zeros(2), goal_at(0.5 * FAR)), time_budget=0.1)
    assert FAR_IN_TIME < 0.5 * FAR
    first, is_new, _ = IntermediateGoals(TUNING).aim(limited, 0.0)
    assert is_new
    np.testing.assert_allclose(first.goal[POSITION], STEP * DIRECTION)
    near = replace(limited, goal=goal_at(0.99 * FAR_IN_TIME))
    assert IntermediateGoals(TUNING).aim(near, 0.0) == (near, False, False)


def test_intermediate_goal_is_on_the_straight_line_and_is_moved_on_before_it_is_reached() -> None:
    goals, far = IntermediateGoals(TUNING), situation(np.zeros(2), goal_at(500.0))
    first, is_new, is_moved_on = goals.aim(far, 0.0)
    assert is_new and not is_moved_on
    np.testing.assert_allclose(first.goal[POSITION], STEP * DIRECTION)
    np.testing.assert_array_equal(first.goal[2:], far.goal[2:])
    same, is_new, _ = goals.aim(far, 10.0)
    assert not is_new
    np.testing.assert_array_equal(same.goal, first.goal)
    second, is_new, is_moved_on = goals.aim(far, 4.4)
    assert is_new and is_moved_on
    turns = (second.goal - first.goal)[POSITION] / (4.0 * np.pi * ROBOT.shell_radius)
    np.testing.assert_allclose(turns, round(float(np.hypot(*turns))) * DIRECTION)


def test_goal_is_aimed_at_itself_again_once_it_is_near() -> None:
    goals, goal = IntermediateGoals(TUNING), goal_at(500.0)
    goals.aim(situation(np.zeros(2), goal), 0.0)
    last = situation(goal[POSITION] - 0.9 * STEP * DIRECTION, goal)
    assert goals.aim(last, 10.0) == (last, True, False)
    assert goals.aim(last, 10.0) == (last, False, False)
