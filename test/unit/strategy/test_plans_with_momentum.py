# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans of the strategy `time_optimal` with momentum: at rest at their end, within every limit."""


import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    imbalance_of_offset,
    momentum_of_push,
    rest_speeds,
    slope_torque,
)
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    MOMENTUM,
    NO_MOMENTUM,
    POSE,
    QUATERNION,
    Vector,
    make_state,
    state_error,
)
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.background import solver_for
from sphere_nmpc.strategy.time_optimal.machine import Following
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

ROBOT = RobotParameters()
TUNING = TimeOptimalSettings()
SOLVER = solver_for(ROBOT, TUNING)
EFFORT = 60_000
START = make_state(np.array([0.7, -0.4]), rotation.exponential(np.array([0.4, -0.5, 0.6])))
GOAL = make_state(np.zeros(2), rotation.exponential(np.array([0.0, 0.0, -0.5])))
PUSH = momentum_of_push(ROBOT, np.array([0.6, 0.4]))
SLOPE = slope_torque(ROBOT, np.radians(0.3), 2.0)
OFFSET = imbalance_of_offset(ROBOT, np.array([5e-4, -8e-4, 6e-4]))
CAUSES = {
    "push": (PUSH, UNDISTURBED),
    "slope": (NO_MOMENTUM, Disturbance(SLOPE)),
    "imbalance": (NO_MOMENTUM, Disturbance(imbalance=OFFSET)),
    "all": (PUSH, Disturbance(SLOPE, OFFSET)),
}


def situation(momentum: Vector, disturbance: Disturbance = UNDISTURBED) -> Situation:
    return Situation(
        0.0, np.append(START, momentum), GOAL, np.array([8.0, -4.0]), ROBOT.lumped,
        disturbance=disturbance,
    )


def arrival_at(goal_of: Situation) -> Plan:
    """Return the plan of a search."""
    found = ArrivalSearch(SOLVER, goal_of, 1).improve(EFFORT)
    assert found is not None
    return found


def integrated(now: Situation, hold: FirstOrderHold) -> Vector:
    """Return the state at the end of a hold, in steps of 10 ms."""
    durations, constants = np.diff(hold.times), ROBOT.lumped.as_array()
    return roll_out(now.state, hold.speeds, durations, constants, 0.01, now.disturbance)[-1]


@pytest.mark.parametrize("kind", CAUSES)
def test_plan_ends_at_rest_at_the_goal_as_predicted_and_keeps_every_limit(kind: str) -> None:
    now = situation(*CAUSES[kind])
    arrival = arrival_at(now)
    hold = arrival.hold
    state = integrated(now, hold)
    # What the plan may leave, 1e-4, and the integration error of its steps of 62.5 ms.
    assert state_error(state, GOAL) < 3e-4
    rest = rest_speeds(state[MOMENTUM], GOAL[QUATERNION])
    assert np.linalg.norm(rest) > 1.0
    # A terminal error of 1e-4 of the largest speed; steps of 62.5 ms hardly change the momentum.
    allowed = 0.02
    np.testing.assert_allclose(hold.speeds[-1], rest, atol=allowed)
    np.testing.assert_allclose(arrival.states[-1, MOMENTUM], state[MOMENTUM], atol=allowed)
    np.testing.assert_array_equal(hold.speeds[0], now.input_in_force)
    assert np.max(np.abs(hold.speeds)) <= ROBOT.max_rotor_speed
    slopes = np.abs(np.diff(hold.speeds, axis=0)) / np.diff(hold.times)[:, None]
    assert np.max(slopes) <= ROBOT.max_rotor_acceleration + 1e-3
    knots = len(hold.times) // 2 + 1
    state = integrated(now, FirstOrderHold(hold.times[:knots], hold.speeds[:knots]))
    on_the_way = float(hold.times[knots - 1])
    predicted = Following(arrival, 0.0, SOLVER).prediction(on_the_way)
    # Integration error of the plan's steps of 62.5 ms.
    assert state_error(predicted, state[POSE]) < 1e-4
    np.testing.assert_allclose(predicted[MOMENTUM], state[MOMENTUM], atol=1e-2)
