# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rest with momentum: commands that hold it, and the nearest orientation at which they can."""

import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    imbalance_of_offset,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, make_state
from sphere_nmpc.strategy.at_rest import TOLERANCE, holdable_goal
from sphere_nmpc.strategy.rest import hold_momentum
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
LIMIT = ROBOT.max_rotor_speed
HEADING = rotation.exponential(np.array([0.0, 0.0, 0.8]))
PLACE = np.array([1.5, -0.7])


@pytest.mark.parametrize(
    "world",
    [
        DisturbanceSettings(slope=float(np.radians(0.5)), slope_direction=2.0),
        DisturbanceSettings(mass_offset_x=2e-3, mass_offset_y=-1e-3),
    ],
    ids=["slope", "imbalance"],
)
def test_plant_stands_still_where_the_command_holds_its_momentum(
    world: DisturbanceSettings,
) -> None:
    start = make_state(np.zeros(2), HEADING)
    plant = RollingPlant(ROBOT, start, world)
    disturbance = disturbance_of(world, ROBOT)
    momentum = 0.1 * disturbance.at_rest(HEADING)
    at_rest = FirstOrderHold(np.array([0.0, 0.1]), np.zeros((2, 2)))
    hold = hold_momentum(at_rest, momentum, disturbance, HEADING, LIMIT, 5.0)
    assert hold.end == pytest.approx(5.1)
    assert np.max(np.abs(hold.speeds)) > 30.0
    for k in range(510):
        plant.advance(hold.at(0.01 * (k + 1)), 0.01)
    # The momentum of the first tenth is picked up late: 2e-3 were measured, and 0.8 or more with
    # the rotors at rest.
    assert np.max(np.abs(plant.state - start)) < 5e-3


def drawn(rng: np.random.Generator, offset: float = 0.0) -> tuple[Vector, Disturbance]:
    """Return a push of about 1 N s on up to 1 degree; offset [m] of the centre of mass."""
    return momentum_of_push(ROBOT, rng.normal(size=2)), Disturbance(
        slope_torque(ROBOT, np.radians(rng.uniform(0.0, 1.0)), rng.uniform(-3.0, 3.0)),
        imbalance_of_offset(ROBOT, offset * rng.normal(size=3)),
    )


def along_z(q: Vector, momentum: Vector, disturbance: Disturbance) -> tuple[float, float]:
    """Return momentum [rad/s] and its rate [rad/s^2] at rest along the body's z axis."""
    axis = rotation.matrix(q)[:, 2]
    return abs(float(axis @ momentum)), abs(float(axis @ disturbance.at_rest(q)))


def test_upright_goal_is_kept_with_any_momentum_and_any_goal_without() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        heading = rotation.exponential(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        upright = make_state(PLACE, heading)
        assert holdable_goal(upright, *drawn(rng, offset=2e-3)) is upright
        goal = make_state(PLACE, rotation.random_quaternion(rng))
        assert holdable_goal(goal, np.zeros(3), UNDISTURBED) is goal


def test_push_turns_the_goal_by_no_more_than_the_tilt_of_the_momentum() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        goal = make_state(PLACE, rotation.random_quaternion(rng))
        momentum = momentum_of_push(ROBOT, rng.normal(size=2))
        size = float(np.linalg.norm(momentum))
        share = along_z(goal[QUATERNION], momentum, UNDISTURBED)[0] / size
        held = holdable_goal(goal, momentum, UNDISTURBED)
        turned = float(rotation.angle_between(held[QUATERNION], goal[QUATERNION]))
        # The z axis at an angle asin(share) from the plane perpendicular to h has to reach what
        # the tolerance leaves. The iteration takes steps of up to half a radian, which together
        # are up to 4e-3 longer than the shortest way; a change below 1e-2 is not even told.
        least = np.arcsin(max(0.0, share - TOLERANCE / size))
        assert least - 1e-6 <= turned <= np.arcsin(share) + 5e-3


@pytest.mark.parametrize("offset", [0.0, 2e-3], ids=["balanced", "2 mm"])
def test_momentum_and_its_rate_are_both_held(offset: float) -> None:
    for seed in range(15):
        rng = np.random.default_rng(seed)
        goal = make_state(PLACE, rotation.random_quaternion(rng))
        cause, given = drawn(rng, offset), goal.copy()
        held = holdable_goal(goal, *cause)
        assert held is not goal
        np.testing.assert_array_equal(goal, given)
        np.testing.assert_array_equal(held[:2], PLACE)
        assert np.linalg.norm(held[QUATERNION]) == pytest.approx(1.0, abs=1e-12)
        momentum, rate = along_z(held[QUATERNION], *cause)
        assert momentum <= TOLERANCE + 1e-9 and rate <= TOLERANCE + 1e-9
