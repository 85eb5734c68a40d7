# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals aimed at: as given, the nearest that can be held, to unload rotors, on the way to far."""

import numpy as np
import pytest

from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    imbalance_of_offset,
    slope_torque,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import NO_MOMENTUM, POSITION, QUATERNION, Vector, make_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.at_rest import AtRest, holdable_goal
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.background import solver_for
from sphere_nmpc.strategy.time_optimal.guide import local_goal, time_to_go
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

ROBOT = RobotParameters()
TUNING = TimeOptimalSettings()
UPRIGHT = make_state(np.array([1.0, -2.0]), np.array([1.0, 0.0, 0.0, 0.0]))
OFFSET = imbalance_of_offset(ROBOT, np.array([2e-3, 0.0, 1e-3]))
DIRECTION, PUSHED = np.array([0.8, 0.6]), np.array([10.0, -5.0, 0.0])
LOADING = np.array([0.0, 1.0, 0.0])
"""Direction of the torque of `OFFSET` in an upright sphere of heading 0."""


def situation(
    goal: Vector, momentum: Vector, disturbance: Disturbance = UNDISTURBED,
    pose: Vector | None = None,
) -> Situation:
    state = np.append(goal if pose is None else pose, momentum)
    return Situation(0.0, state, goal, np.zeros(2), ROBOT.lumped, disturbance=disturbance)


def out_of_balance(momentum: float, slope: Vector = UNDISTURBED.slope) -> Situation:
    """Return a situation with momentum along the torque of the imbalance [rad/s]."""
    return situation(UPRIGHT, momentum * LOADING, Disturbance(slope, OFFSET))


@pytest.fixture
def held() -> AtRest:
    return AtRest(ControllerSettings(), ROBOT, TUNING)


def test_goal_is_kept_without_momentum_and_where_it_can_be_held(held: AtRest) -> None:
    still, pushed = (situation(UPRIGHT, h * np.array([30.0, -20.0, 0.0])) for h in (0.0, 1.0))
    for now in (still, pushed, out_of_balance(50.0)):
        for holding in (False, True):
            assert held.goal(now, None, holding) is UPRIGHT
            assert held.limitation == ""


@pytest.mark.parametrize(
    ("now", "holding"),
    [
        (out_of_balance(78.0), True),
        (out_of_balance(92.0), False),
        # The torque of the imbalance unloads the rotors where they are.
        (out_of_balance(-92.0), True),
        (situation(UPRIGHT, 92.0 * LOADING), True),
        # A slope of 3 degrees loads them much faster, 73 rad/s^2, than 2.2 mm unload.
        (out_of_balance(92.0, slope_torque(ROBOT, np.radians(3.0), 0.0)), True),
    ],
    ids=["not yet", "on the way", "by itself", "balanced", "steep"],
)
def test_rotors_are_not_unloaded(held: AtRest, now: Situation, holding: bool) -> None:
    assert held.goal(now, None, holding) is UPRIGHT
    assert held.limitation == ""


def test_rotors_are_unloaded_at_the_orientation_that_does_so_fastest(held: AtRest) -> None:
    now = out_of_balance(92.0)
    assert now.disturbance.at_rest(UPRIGHT[QUATERNION]) @ LOADING > 0.0
    aimed = held.goal(now, None, holding=True)
    assert "unloads" in held.limitation
    np.testing.assert_array_equal(aimed[:2], UPRIGHT[:2])
    # No torque is larger than that of a horizontal offset.
    torque = now.disturbance.at_rest(aimed[QUATERNION])
    assert torque @ LOADING == pytest.approx(-np.linalg.norm(OFFSET), rel=1e-9)
    # It can be held there: neither is along the body's z axis.
    assert holdable_goal(aimed, now.momentum, now.disturbance) is aimed


def on_the_way(place: Vector, distance: float, momentum: Vector = NO_MOMENTUM) -> Situation:
    """Return the situation at a place with a goal at a distance in `DIRECTION`."""
    goal = make_state(distance * DIRECTION, (np.cos(0.3), 0.0, 0.0, np.sin(0.3)))
    return situation(goal, momentum, pose=make_state(place, UPRIGHT[QUATERNION]))


def test_far_goal_is_approached_by_legs_on_the_straight_line() -> None:
    solver = solver_for(ROBOT, TUNING)
    leg = solver.near_distance
    for near in (on_the_way(np.zeros(2), 2.4e4), on_the_way(np.zeros(2), 2.4 * leg, PUSHED)):
        (aim,) = local_goal(near, solver, 0).aims
        assert aim.is_final and aim.situation is near
    for place, momentum, length in (
        (leg * DIRECTION, PUSHED, leg), (np.zeros(2), NO_MOMENTUM, 1e4),
    ):
        far = on_the_way(place, 1e5, momentum)
        (aim,) = local_goal(far, solver, 0).aims
        np.testing.assert_allclose(aim.situation.goal[POSITION], place + length * DIRECTION)
        assert not aim.is_final and not aim.detour
        assert time_to_go(far, aim.situation.goal[POSITION], 100.0) > 1e4
