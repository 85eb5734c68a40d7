# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The robot of the simulator: its drives, what contradicts their limits, and its description."""

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import PALM

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.world.drives import PLANNED_LIMITS, CommandFollower, beyond
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.robot_description import make_urdf


@pytest.fixture
def follower() -> CommandFollower:
    return CommandFollower(max_speed=100.0, max_acceleration=400.0, command_timeout=0.5)


def hold(*knots: tuple[float, float, float]) -> FirstOrderHold:
    array = np.array(knots)
    return FirstOrderHold(array[:, 0], array[:, 1:])


def test_trajectory_has_priority_and_late_samples_of_it_are_ignored(follower) -> None:
    assert follower.knots_between(0.0, 9.0) == []
    follower.follow_speeds(np.array([7.0, 7.0]), 0.0)
    follower.follow_trajectory(hold((0, 0, 0), (0.4, 40, 20)))
    for time, speeds in ((0.2, [20, 10]), (0.4, [40, 20]), (0.45, [0, 0])):
        np.testing.assert_allclose(follower.commanded(time), speeds)
    follower.follow_speeds(np.array([3.0, 3.0]), 0.5)
    np.testing.assert_allclose(follower.commanded(0.6), [0, 0])
    follower.follow_speeds(np.array([7.0, -7.0]), 0.91)
    np.testing.assert_allclose(follower.commanded(1.0), [7, -7])
    # Without a successor they are dropped after the time-out.
    follower.follow_speeds(np.array([7.0, -7.0]), 1.0)
    np.testing.assert_allclose(follower.commanded(1.5), [7, -7])
    np.testing.assert_allclose(follower.commanded(1.501), [0, 0])


def test_new_trajectory_replaces_the_previous_one(follower) -> None:
    follower.follow_trajectory(hold((0, 0, 0), (5, 50, 50)))
    follower.follow_trajectory(hold((0, 0, 0), (1, 30, 0), (2, 0, 0)))
    np.testing.assert_allclose(follower.commanded(1.5), [15, 0])
    np.testing.assert_allclose(follower.commanded(3.0), [0, 0])
    assert follower.knots_between(0.0, 2.0) == [1.0] and follower.knots_between(1.0, 1.5) == []


speeds = st.tuples(st.floats(-100, 100), st.floats(-100, 100)).map(np.array)


@given(
    now=speeds, wanted=st.tuples(st.floats(-900, 900), st.floats(-900, 900)).map(np.array),
    step=st.floats(1e-9, 0.1),
)
def test_drives_keep_all_limits_and_approach_the_command_as_fast_as_they_allow(
    now: np.ndarray, wanted: np.ndarray, step: float
) -> None:
    follower = CommandFollower(100.0, 400.0, 0.5)
    follower.follow_speeds(wanted, 0.0)
    after = follower.speeds_after(now, 0.0, step)
    assert np.all(np.abs(after) <= 100.0)
    assert np.all(np.abs(after - now) <= 400.0 * step * (1.0 + 1e-12) + 1e-12)
    target = np.clip(wanted, -100.0, 100.0)
    reached = np.abs(target - now) <= 400.0 * step
    np.testing.assert_array_equal(after[reached], target[reached])
    assert np.all(np.abs(target - after) <= np.abs(target - now) + 1e-12)


def of_drives(torque_limit: float, **robot: float) -> str:
    settings = RigidBodySettings(torque_limit=torque_limit)
    return settings.contradiction(RobotParameters(**robot)) or ""


def of_controller(torque_limit: float, **robot: float) -> str:
    planned = {name: getattr(RobotParameters(**robot), name) for name in PLANNED_LIMITS}
    return beyond(RobotParameters(), planned, "/controller", torque_limit)


LARGE = {"shell_radius": 1.0, "rotor_mass": 20.0, "rotor_axial_inertia": 0.9,
         "rotor_transverse_inertia": 0.45, "max_rotor_speed": 60.0, "max_rotor_acceleration": 50.0}


@pytest.mark.parametrize(
    ("told", "torque_limit", "robot", "figures"),
    [
        (of_drives, 3.2, LARGE, ("3.2 N m", "45 N m", "50 rad/s^2")),
        (of_drives, 3.2, {}, ()),
        (of_drives, 1.6, {"max_rotor_torque": 1.6}, ()),
        (of_controller, 3.2, {"max_rotor_speed": 120.0},
         ("/controller", "120 rad/s", "100 rad/s", "as in this node")),
        (of_controller, 1.6, {}, ("/controller", "400 rad/s^2", "200 rad/s^2", "1.6 N m")),
        (of_controller, 3.2, {}, ()),
        (of_controller, 3.2, {"max_rotor_acceleration": 1000.0, "max_rotor_torque": 3.0}, ()),
    ],
)
def test_limits_that_contradict_each_other_are_told_in_one_line(
    told, torque_limit, robot, figures
) -> None:
    line = told(torque_limit, **robot)
    assert bool(line) is bool(figures) and "\n" not in line
    assert all(figure in line for figure in figures)


ROBOT = RobotParameters()


def numbers(element, name):
    return np.array([float(word) for word in element.get(name).split()])


@pytest.mark.parametrize("robot", [RobotParameters(rotor_mass=0.8, shell_inertia=0.05), PALM])
def test_masses_and_inertias_add_up(robot):
    root = ElementTree.fromstring(make_urdf(robot).partition("\n")[2])
    place = {"base_link": np.zeros(3)}
    for joint in root.findall("joint"):
        place[joint.find("child").get("link")] = numbers(joint.find("origin"), "xyz")
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for link in root.iter("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        own = {key: float(value) for key, value in inertial.find("inertia").attrib.items()}
        m = float(inertial.find("mass").get("value"))
        r = place[link.get("name")] + numbers(inertial.find("origin"), "xyz")
        mass, moment = mass + m, moment + m * r
        inertia += [
            [own["ixx"], own["ixy"], own["ixz"]],
            [own["ixy"], own["iyy"], own["iyz"]],
            [own["ixz"], own["iyz"], own["izz"]],
        ]
        inertia += m * (r @ r * np.eye(3) - np.outer(r, r))
    assert mass == pytest.approx(robot.total_mass)
    np.testing.assert_allclose(moment, 0.0, atol=1e-8 * mass)
    expected = [robot.transverse_inertia, robot.transverse_inertia, robot.axial_inertia]
    np.testing.assert_allclose(
        inertia, np.diag(expected), rtol=1e-6, atol=1e-7 * robot.transverse_inertia
    )
