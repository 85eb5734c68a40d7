# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands that keep the sphere at rest with momentum."""

import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import Drift, imbalance_of_offset, slope_torque
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, make_state
from sphere_nmpc.strategy.rest import hold_momentum, is_saturated, ramp_to, speeds_of_rest
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
LIMIT = ROBOT.max_rotor_speed
HEADING = rotation.exponential(np.array([0.0, 0.0, 0.8]))


def follow(plant: RollingPlant, hold: FirstOrderHold, step: float = 0.01) -> None:
    """Let the rotors of a plant follow a hold to its end."""
    for k in range(round((hold.end - hold.start) / step)):
        plant.advance(hold.at(hold.start + (k + 1) * step), step)


@pytest.mark.parametrize(
    ("momentum", "expected", "saturated"),
    [
        ([30.0, -40.0, 0.0], [30.0, -40.0], False),
        ([130.0, -40.0, 0.0], [LIMIT, -40.0], True),
        ([30.0, -140.0, 0.0], [30.0, -LIMIT], True),
    ],
)
def test_speeds_of_rest_stay_within_the_limit(
    momentum: list[float], expected: list[float], saturated: bool
) -> None:
    drift = Drift(rotation.matrix(HEADING) @ np.array(momentum))
    np.testing.assert_allclose(speeds_of_rest(drift, HEADING, LIMIT), expected, rtol=1e-12)
    assert is_saturated(drift, HEADING, LIMIT) is saturated


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
    slope = slope_torque(ROBOT, world.slope, world.slope_direction)
    drift = Drift(
        slope=slope, imbalance=imbalance_of_offset(ROBOT, np.array(world.mass_offset))
    )
    at_rest = FirstOrderHold(np.array([0.0, 0.1]), np.zeros((2, 2)))
    hold = hold_momentum(
        at_rest, drift.after_rest(HEADING, 0.1), HEADING, LIMIT, 5.0
    )
    assert hold.end == pytest.approx(5.1)
    assert np.max(np.abs(hold.speeds)) > 30.0
    follow(plant, hold)
    # The momentum of the first tenth is picked up late: 2e-3 were measured, and 0.8 or more with
    # the rotors at rest.
    assert np.max(np.abs(plant.state - start)) < 5e-3


def test_command_that_holds_momentum_ends_at_the_limit() -> None:
    drift = Drift(slope=slope_torque(ROBOT, np.radians(1.0), 0.0))
    at_rest = FirstOrderHold.constant(3.0, np.zeros(2))
    hold = hold_momentum(at_rest, drift, HEADING, LIMIT, 8.0)
    assert np.max(np.abs(hold.speeds)) == LIMIT
    assert np.max(np.abs(drift.after_rest(HEADING, 8.0).rest_speeds(HEADING))) > LIMIT


def test_ramp_ends_both_rotors_at_the_same_time_with_the_faster_one_at_the_limit() -> None:
    start, target = np.array([10.0, -20.0]), np.array([60.0, 5.0])
    ramp = ramp_to(2.0, start, target, 400.0)
    assert ramp.start == 2.0 and ramp.end == pytest.approx(2.0 + 50.0 / 400.0)
    np.testing.assert_array_equal(ramp.at(2.0), start)
    np.testing.assert_allclose(ramp.at(ramp.end), target, rtol=1e-14)
    middle: Vector = ramp.at(0.5 * (ramp.start + ramp.end))
    np.testing.assert_allclose(middle, 0.5 * (start + target), rtol=1e-12)
