# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of a node: which are its own, and what is said of those that ROS would misread."""

import pytest

pytest.importorskip("rclpy")

from sphere_nmpc.ros.startup import RosArgumentsError, without_ros_arguments


@pytest.mark.parametrize(
    ("words", "own"),
    [
        ("", ""),
        ("--port 8080 --ros-args -p strategy:=paper -r __ns:=/left", "--port 8080"),
        ("--ros-args --param a:=b --remap /clock:=/clock --log-level rcl:=debug -- 1 0", "1 0"),
    ],
)
def test_arguments_of_ros_are_left_out(words, own) -> None:
    assert without_ros_arguments(words.split()) == own.split()


@pytest.mark.parametrize(
    "words",
    ["strategy:=paper", "--ros-args strategy:=paper", "--ros-args -p a:=b strategy:=paper",
     "--ros-args -p a:=b -- strategy:=paper"],
)
def test_assignment_alone_is_refused_with_what_to_type(words) -> None:
    with pytest.raises(RosArgumentsError) as caught:
        without_ros_arguments(words.split())
    assert str(caught.value) == (
        "given strategy:=paper, expected --ros-args -p strategy:=paper for a parameter, "
        "-r strategy:=paper for a remapping"
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--ros-args --params_file a.yaml", "arguments after --ros-args: given ['--params_file', "
         "'a.yaml'], which ROS does not know"),
        ("--ros-args -p strategy", "Couldn't parse parameter override rule: '-p strategy'"),
    ],
)
def test_argument_that_ros_refuses_is_named(words, told) -> None:
    with pytest.raises(RosArgumentsError) as caught:
        without_ros_arguments(words.split())
    assert told in str(caught.value)
