# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The plants with robots from 3 cm to 1 m: steps, drives and contact suit each of them."""

import numpy as np
import pytest
from other_robots import ROBOTS

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, angle_error, position_error
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.world.plant import rolling_plant
from sphere_sim.world.plant.contract import Plant, step_scale, time_scale
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

TABLE_1 = RobotParameters()
PACE = 0.01
"""Step of the simulator between two samples of the command [s]."""


def states(plant: Plant, robot: RobotParameters, share: float, seed: int) -> list[Vector]:
    """Return the states on ramps between random rotor speeds, up to `share` of the largest."""
    rng = np.random.default_rng(seed)
    limit = share * robot.max_rotor_speed
    here, found = np.zeros(2), []
    for there in rng.uniform(-limit, limit, (6, 2)):
        steps = round(2.0 * limit / robot.max_rotor_acceleration / PACE)
        for i in range(steps):
            plant.advance(here + (i + 1) / steps * (there - here), PACE)
            found.append(plant.state)
        here = there
    return found


def deviation(first: list[Vector], second: list[Vector], radius: float) -> float:
    """Return the largest deviation of positions, in radii, and of angles [rad]."""
    return max(
        max(position_error(a, b) / radius, angle_error(a, b))
        for a, b in zip(first, second, strict=True)
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_contact_plant_deviates_from_ideal_rolling_as_for_table_1(name) -> None:
    pytest.importorskip("mujoco")
    robot = ROBOTS[name]
    # At half the speed: at full speed small robots take curves in which friction 0.8 lets them
    # slip.
    for seed in range(2):
        start = np.array([0.0, 0.0, *np.random.default_rng(seed).normal(size=4)])
        start[2:] /= np.linalg.norm(start[2:])
        ideal = states(RollingPlant(robot, start), robot, 0.5, seed)
        contact = states(RigidBodyPlant(robot, start), robot, 0.5, seed)
        # Mostly the lag of the drives; 0.005 to 0.013 were seen.
        assert deviation(ideal, contact, robot.shell_radius) < 0.02


@pytest.mark.parametrize("name", ROBOTS)
def test_steps_of_the_rolling_plant_are_short_enough(monkeypatch, name) -> None:
    robot, start = ROBOTS[name], np.array([0.0, 0.0, 0.03, 0.454, 0.88, 0.1363])
    start[2:] /= np.linalg.norm(start[2:])
    usual = states(RollingPlant(robot, start), robot, 1.0, 0)
    monkeypatch.setattr(rolling_plant, "MAX_STEP", 5e-4)
    fine = states(RollingPlant(robot, start), robot, 1.0, 0)
    assert deviation(usual, fine, robot.shell_radius) < 1e-5


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
