# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nearest orientation at which the rotors hold the momentum."""

import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import (
    NO_DRIFT,
    Drift,
    imbalance_of_offset,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, make_state
from sphere_nmpc.strategy.holdable_goal import (
    MOMENTUM_TOLERANCE,
    TORQUE_TOLERANCE,
    given_up_angle,
    holdable_goal,
)

ROBOT = RobotParameters()
PLACE = np.array([1.5, -0.7])


def upright(heading: float) -> Vector:
    return make_state(PLACE, rotation.exponential(np.array([0.0, 0.0, heading])))


def drawn_drift(rng: np.random.Generator, offset: float = 0.0) -> Drift:
    """Return a push of about 1 N s on up to 1 degree; offset [m] of the centre of mass."""
    return Drift(
        momentum_of_push(ROBOT, rng.normal(size=2)),
        slope_torque(ROBOT, np.radians(rng.uniform(0.0, 1.0)), rng.uniform(-3.0, 3.0)),
        imbalance_of_offset(ROBOT, offset * rng.normal(size=3)),
    )


def along_z(q: Vector, drift: Drift) -> tuple[float, float]:
    """Return momentum [rad/s] and its rate [rad/s^2] at rest along the body's z axis."""
    axis = rotation.matrix(q)[:, 2]
    return abs(float(axis @ drift.momentum)), abs(float(axis @ drift.torque_at_rest(q)))


@pytest.mark.parametrize("seed", range(5))
def test_upright_goal_is_kept_for_any_push_slope_and_imbalance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    goal = upright(rng.uniform(-np.pi, np.pi))
    assert holdable_goal(goal, drawn_drift(rng, offset=2e-3)) is goal


def test_any_goal_is_kept_without_momentum() -> None:
    goal = make_state(PLACE, rotation.random_quaternion(np.random.default_rng(0)))
    assert holdable_goal(goal, NO_DRIFT) is goal


@pytest.mark.parametrize("seed", range(10))
def test_push_turns_the_goal_by_no_more_than_the_tilt_of_the_momentum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    goal = make_state(PLACE, rotation.random_quaternion(rng))
    drift = Drift(momentum_of_push(ROBOT, rng.normal(size=2)))
    size = float(np.linalg.norm(drift.momentum))
    share = along_z(goal[QUATERNION], drift)[0] / size
    held = holdable_goal(goal, drift)
    turned = float(rotation.angle_between(held[QUATERNION], goal[QUATERNION]))
    # The z axis at an angle asin(share) from the plane perpendicular to h has to reach what the
    # tolerance leaves. The iteration takes steps of up to half a radian, which together are up to
    # 4e-3 longer than the shortest way; a change below 1e-2 is not even told.
    least = np.arcsin(max(0.0, share - MOMENTUM_TOLERANCE / size))
    assert least - 1e-6 <= turned <= np.arcsin(share) + 5e-3


def check_held(seed: int, offset: float) -> None:
    """Check both conditions at a random goal with a random drift."""
    rng = np.random.default_rng(seed)
    goal = make_state(PLACE, rotation.random_quaternion(rng))
    drift = drawn_drift(rng, offset)
    given = goal.copy()
    held = holdable_goal(goal, drift)
    assert held is not goal
    np.testing.assert_array_equal(goal, given)
    np.testing.assert_array_equal(held[:2], PLACE)
    assert np.linalg.norm(held[QUATERNION]) == pytest.approx(1.0, abs=1e-12)
    momentum, rate = along_z(held[QUATERNION], drift)
    assert momentum <= MOMENTUM_TOLERANCE + 1e-9 and rate <= TORQUE_TOLERANCE + 1e-9


@pytest.mark.parametrize("offset", [0.0, 2e-3], ids=["balanced", "2 mm"])
def test_momentum_and_its_rate_are_both_held(offset: float) -> None:
    for seed in range(40):
        check_held(seed, offset)


def test_small_change_is_not_told() -> None:
    assert given_up_angle(0.009) == ""
    assert "orientation by 5.0 deg" in given_up_angle(float(np.radians(5.0)))
