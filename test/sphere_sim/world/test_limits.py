# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Limits that contradict each other are named with both figures, and others are not."""

import pytest

from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.world.limits import PLANNED_LIMITS, beyond
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

LARGE = RobotParameters(
    shell_radius=1.0, rotor_axial_inertia=0.9, max_rotor_speed=60.0, max_rotor_acceleration=50.0
)


def limits(**changes: float) -> dict[str, float]:
    """Return the limits that a controller with a robot of these parameters has."""
    robot = RobotParameters(**changes)
    return {name: getattr(robot, name) for name in PLANNED_LIMITS}


@pytest.mark.parametrize(
    ("robot", "settings", "figures"),
    [
        (LARGE, {"torque_limit": 3.2}, ("3.2 N m", "45 N m", "50 rad/s^2")),
        (RobotParameters(), {"torque_limit": 1.6}, ("1.6 N m", "3.2 N m", "400 rad/s^2")),
        (RobotParameters(max_rotor_torque=2.0), {"torque_limit": 1.6}, ("1.6 N m", "2 N m")),
    ],
)
def test_drives_that_are_too_weak_for_the_robot_are_named(robot, settings, figures) -> None:
    line = RigidBodySettings(**settings).contradiction(robot)
    assert line is not None and "\n" not in line
    assert all(figure in line for figure in figures)


@pytest.mark.parametrize(
    ("robot", "settings"),
    [
        (LARGE, {}),
        (LARGE, {"torque_limit": 45.0}),
        (RobotParameters(), {"torque_limit": 3.2}),
        (RobotParameters(max_rotor_torque=1.6), {"torque_limit": 1.6}),
    ],
)
def test_drives_that_are_strong_enough_are_not_named(robot, settings) -> None:
    assert RigidBodySettings(**settings).contradiction(robot) is None


@pytest.mark.parametrize(
    ("changes", "torque_limit", "figures"),
    [
        ({"max_rotor_speed": 120.0}, 3.2, ("120 rad/s", "100 rad/s", "as in this node")),
        ({"max_rotor_acceleration": 500.0}, 9.0, ("500 rad/s^2", "400 rad/s^2")),
        ({}, 1.6, ("400 rad/s^2", "200 rad/s^2", "1.6 N m")),
    ],
)
def test_limits_beyond_those_of_the_robot_are_named(changes, torque_limit, figures) -> None:
    line = beyond(RobotParameters(), limits(**changes), "/controller", torque_limit)
    assert "/controller" in line and "\n" not in line and ";" not in line
    assert all(figure in line for figure in figures)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"max_rotor_speed": 60.0, "max_rotor_acceleration": 100.0},
        {"max_rotor_acceleration": 1000.0, "max_rotor_torque": 3.0},
    ],
)
def test_limits_within_those_of_the_robot_are_not_named(changes) -> None:
    assert beyond(RobotParameters(), limits(**changes), "/controller", 3.2) == ""
