# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The plants with robots from 3 cm to 1 m: steps, drives and contact suit each of them."""

import numpy as np
import pytest
from other_robots import ROBOTS, deviations, states

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.world.plant import rolling_plant
from sphere_sim.world.plant.contract import step_scale, time_scale
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

TABLE_1 = RobotParameters()
@pytest.mark.parametrize("name", ROBOTS)
def test_contact_plant_deviates_from_ideal_rolling_as_for_table_1(name) -> None:
    pytest.importorskip("mujoco")
    # Mostly the lag of the drives; 0.005 to 0.013 were seen.
    distances, angles = deviations(ROBOTS[name], 2)
    assert distances.max() < 0.02 and angles.max() < 0.02


@pytest.mark.parametrize("name", ROBOTS)
def test_steps_of_the_rolling_plant_are_short_enough(monkeypatch, name) -> None:
    robot, start = ROBOTS[name], as_state([0.0, 0.0, 0.03, 0.454, 0.88, 0.1363])
    limit = robot.max_rotor_speed
    knots = np.random.default_rng(0).uniform(-limit, limit, (6, 2))
    ramp = 2.0 * limit / robot.max_rotor_acceleration
    usual = states(RollingPlant(robot, start), knots, ramp)
    monkeypatch.setattr(rolling_plant, "MAX_STEP", 5e-4)
    fine = states(RollingPlant(robot, start), knots, ramp)
    np.testing.assert_allclose(usual[:, :2], fine[:, :2], atol=1e-5 * robot.shell_radius)
    np.testing.assert_allclose(usual[:, 2:], fine[:, 2:], atol=1e-5)


def test_errors_of_the_parameters_do_not_change_the_steps() -> None:
    rng = np.random.default_rng(0)
    for name, robot in ROBOTS.items():
        if name != "10 cm":  # its time scale is between two powers of two
            found = {step_scale(perturbed(robot, 0.1, rng)) for _ in range(20)}
            assert found == {step_scale(robot)}
    assert step_scale(ROBOTS["3.65 cm"]) == 0.125 and step_scale(ROBOTS["1 m"]) == 1.0
    assert time_scale(TABLE_1) == step_scale(TABLE_1) == 1.0


def test_drives_and_contact_are_those_that_were_measured_or_that_are_given() -> None:
    found = RigidBodySettings().for_robot(TABLE_1)
    assert found.drive_bandwidth == 300.0 and found.torque_limit == 3.2
    assert found.contact_time_constant == 0.004 and found.time_step == 0.002
    given = RigidBodySettings(
        drive_bandwidth=70.0, torque_limit=2.0, contact_time_constant=0.01, time_step=0.001
    )
    assert all(given.for_robot(robot) == given for robot in ROBOTS.values())
    coarse = RigidBodySettings(time_step=0.004).for_robot(TABLE_1)
    assert coarse.contact_time_constant == 0.008
    stiff = RigidBodySettings(contact_time_constant=0.003).for_robot(TABLE_1)
    assert stiff.time_step == 0.0015
    with pytest.raises(InvalidParameterError, match="contact_time_constant"):
        RigidBodySettings(contact_time_constant=0.003, time_step=0.002)
