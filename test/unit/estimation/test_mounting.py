# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Mounting of the IMU by its frame in a description of the robot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.errors import InvalidInputError, InvalidParameterError
from sphere_nmpc.estimation.mounting import RobotFrames

ROBOT = """<robot name="sphere"><link name="base_link"/><link name="plate"/><link name="chip"/>
<joint name="a" type="fixed"><parent link="base_link"/><child link="plate"/>
  <origin xyz="0.1 0.02 -0.05" rpy="0.3 -0.7 2.1"/></joint>
<joint name="b" type="fixed"><parent link="plate"/><child link="chip"/>
  <origin rpy="-1.2 0.4 0.5" xyz="0.01 0 0.003"/></joint>
<joint name="c" type="continuous"><parent link="base_link"/><child link="rotor"/></joint>
<joint name="d" type="fixed"><parent link="rotor"/><child link="turning"/></joint>
<joint name="e" type="fixed"><parent link="here"/><child link="there"/></joint>
<joint name="f" type="fixed"><parent link="there"/><child link="here"/></joint>
</robot>"""


def test_fixed_joints_are_followed_from_the_body_to_the_frame() -> None:
    first, second = (Rotation.from_euler("xyz", rpy)
                     for rpy in ((0.3, -0.7, 2.1), (-1.2, 0.4, 0.5)))
    place, turn = RobotFrames(ROBOT).mounting("chip", "base_link")
    np.testing.assert_allclose(
        place, np.array([0.1, 0.02, -0.05]) + first.apply([0.01, 0.0, 0.003]), atol=1e-15
    )
    expected = (first * second).as_quat()[[3, 0, 1, 2]]
    np.testing.assert_allclose(abs(turn @ expected), 1.0, atol=1e-15)
    place, turn = RobotFrames(ROBOT).mounting("base_link", "base_link")
    assert [*place, *turn] == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("frame", ["", "imu", "rotor", "turning", "here"])
def test_frame_that_is_not_fixed_to_the_body_is_refused_by_name(frame) -> None:
    with pytest.raises(InvalidInputError, match=rf"frame: given '{frame}', .*chip, here, plate"):
        RobotFrames(ROBOT).mounting(frame, "base_link")


@pytest.mark.parametrize("text", [
    "robot.urdf", ROBOT.replace("0.02", "two"), ROBOT.replace("0.02 ", ""),
    ROBOT.replace('<child link="chip"/>', ""),
    ROBOT.replace('<parent link="plate"/>', "<parent/>"),
])
def test_description_that_is_none_is_refused(text) -> None:
    with pytest.raises(InvalidParameterError, match=r"description: given .*, expected a robot"):
        RobotFrames(text)
