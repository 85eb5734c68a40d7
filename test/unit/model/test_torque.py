# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Torques of plans, and the acceleration limit that follows from a torque limit."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_nmpc.model.torque import largest_acceleration, torques, within_torque
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
INERTIA = ROBOT.rotor_axial_inertia


def test_torques_of_a_plan_are_those_of_the_plant() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(6) * 0.25
    hold = FirstOrderHold(times, np.vstack((np.zeros(2), rng.uniform(-90.0, 90.0, (5, 2)))))
    plant = RollingPlant(ROBOT, as_state([0.0, 0.0, 0.5, 0.5, 0.5, 0.5]))
    states, seen = [plant.state], []
    for speeds in hold.speeds[1:]:
        plant.advance(speeds, 0.25)
        states.append(plant.state)
        seen.append(plant.rotor_torques)
    after, before = torques(np.array(states), hold, ROBOT.lumped, INERTIA)
    np.testing.assert_allclose(before, seen, atol=1e-9)
    # At rest the shell does not turn: what is left is the reaction of its inertia.
    np.testing.assert_allclose(after[0], INERTIA * hold.speeds[1] / 0.25, rtol=0.08)
    one = FirstOrderHold.constant(0.0, np.zeros(2))
    assert [part.shape for part in torques(states[0][None], one, ROBOT.lumped, INERTIA)] == [
        (0, 2), (0, 2)
    ]


@pytest.mark.parametrize("limit", [0.4, 3.2])
def test_slew_within_a_torque_limit_keeps_it_everywhere(limit: float) -> None:
    robot = replace(ROBOT, max_rotor_torque=limit)
    slew = largest_acceleration(robot)
    assert slew < limit / INERTIA
    rng = np.random.default_rng(2)
    worst = 0.0
    for _ in range(200):
        quaternion = rng.normal(size=4)
        state = as_state([0.0, 0.0, *quaternion / np.linalg.norm(quaternion)])
        change = slew * 1e-3 * rng.choice([-1.0, 1.0], 2)
        speeds = 100.0 * rng.choice([-1.0, 1.0], 2)
        hold = FirstOrderHold(np.array([0.0, 1e-3]), np.vstack((speeds, speeds + change)))
        after, _ = torques(np.vstack((state, state)), hold, ROBOT.lumped, INERTIA)
        worst = max(worst, float(np.max(np.abs(after))))
    assert 0.9 * limit < worst <= limit


def test_without_a_limit_or_with_a_generous_one_the_slew_stays_and_too_low_a_one_is_refused():
    assert largest_acceleration(ROBOT) == ROBOT.max_rotor_acceleration
    assert within_torque(replace(ROBOT, max_rotor_torque=10.0)).max_rotor_acceleration == 400.0
    # The turning shell alone exceeds it.
    with pytest.raises(InvalidParameterError, match="max_rotor_torque"):
        largest_acceleration(replace(ROBOT, max_rotor_torque=0.05))
