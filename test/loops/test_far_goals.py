# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Far goals: the work of a sample is independent of the distance, and the path is straight."""


import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import (
    FARTHEST,
    POSITION,
    Vector,
    make_state,
    state_error,
    without_momentum,
)
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.background import solver_for
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import (
    SteadyRolling,
    steady_interval,
)
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

pytestmark = pytest.mark.slow

ROBOT = RobotParameters()
TUNING = TimeOptimalSettings()
START = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
ROLLING = SteadyRolling.of(ROBOT.lumped, ROBOT.max_rotor_speed)
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


@pytest.mark.parametrize(
    ("strategy", "distance"),
    [
        ("time_optimal", 1e2), ("time_optimal", 0.999 * FARTHEST), ("plan_keeping", 1e5),
        ("paper", 0.999 * FARTHEST),
    ],
)
def test_path_is_straight_from_the_start_at_every_distance(strategy, distance) -> None:
    duration = 5.0
    trajectory = run(strategy, distance, duration)
    along = float(trajectory.states[-1][POSITION] @ DIRECTION)
    aside = np.abs(trajectory.states[:, POSITION] @ np.array([-0.6, 0.8]))
    assert along > 0.4 * duration * ROLLING.speed
    assert np.max(aside) < 1.0
    # Work of each sample: knots of a manoeuvre at either end, whatever lies between, and of rest.
    assert max(d.plan.hold.times.size for d in trajectory.decisions) <= 80


def planned(distance: float, seed: int) -> tuple[Situation, ArrivalSearch]:
    rng = np.random.default_rng(seed)
    start = make_state((0.0, 0.0), random_quaternion(rng))
    goal = make_state(distance * DIRECTION, random_quaternion(rng))
    beginning = Situation(0.0, without_momentum(start), goal, np.zeros(2), ROBOT.lumped)
    return beginning, ArrivalSearch(solver_for(ROBOT, TUNING), beginning, 0)


@pytest.mark.parametrize("distance", [8.0, 100.0])
def test_plan_with_whole_turns_leads_to_the_goal_when_all_of_it_is_integrated(distance) -> None:
    beginning, search = planned(distance, seed=int(distance))
    found = search.improve(50_000)
    assert found is not None
    _, turns = steady_interval(np.diff(found.hold.times), ROLLING)
    assert turns >= distance / ROLLING.turn_length - 4
    # Steady rolling is integrated exactly in steps of any length.
    inputs, durations, constants = found.hold.speeds, np.diff(found.hold.times), ROBOT.lumped
    step = solver_for(ROBOT, TUNING).grid.fine
    end = roll_out(beginning.state, inputs, durations, constants.as_array(), step)[-1]
    # The direction, which is corrected on the way, is within the terminal error.
    assert state_error(end, found.goal.pose) < distance * TUNING.arrival_error
    assert found.duration < distance / ROLLING.speed + 2.5


def test_known_arrival_is_improved_and_the_goal_is_reached_at_top_speed() -> None:
    beginning, search = planned(25.0, seed=2)
    found = search.improve(60_000)
    assert found is not None
    again = ArrivalSearch(solver_for(ROBOT, TUNING), beginning, 1, known=found)
    better = again.improve(40_000)
    assert better is not None and better.duration <= found.duration
    trajectory = run("time_optimal", 15.0, 15.0 / ROLLING.speed + 3.0)
    assert state_error(trajectory.states[-1], goal_at(15.0)) < 1e-3
    cruise = (trajectory.times > 3.0) & (trajectory.times < 15.0 / ROLLING.speed - 3.0)
    fastest = np.max(np.abs(trajectory.speeds[cruise]), axis=1)
    assert np.mean(fastest > 0.9 * ROBOT.max_rotor_speed) > 0.95
