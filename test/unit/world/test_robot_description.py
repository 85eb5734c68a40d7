# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The URDF against the robot's parameters."""

from xml.etree import ElementTree

import numpy as np
import pytest
from robots import PALM

from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.world.robot_description import make_urdf


def numbers(element, name):
    return np.array([float(word) for word in element.get(name).split()])


@pytest.mark.parametrize("robot", [RobotParameters(rotor_mass=0.8, shell_inertia=0.05), PALM])
def test_masses_and_inertias_add_up(robot):
    root = ElementTree.fromstring(make_urdf(robot).partition("\n")[2])
    place = {"base_link": np.zeros(3)}
    for joint in root.iter("joint"):
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
