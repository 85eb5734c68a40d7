# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages written and read in their serialised form, compared with those of rclpy."""

import struct

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros import conversions as cv
from sphere_nmpc.ros import serialised

STAMPS = st.integers(0, 2_000_000_000_000_000_000)
SPEEDS = st.tuples(*[st.floats(-100.0, 100.0)] * 2).map(np.array)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def states(draw) -> np.ndarray:
    place = draw(st.tuples(*[st.floats(-1e6, 1e6)] * 2))
    turn = np.array(draw(st.tuples(*[st.floats(-1.0, 1.0)] * 4)))
    size = np.linalg.norm(turn)
    return np.array([*place, *(turn / size if size > 0.1 else (1.0, 0.0, 0.0, 0.0))])


@st.composite
def holds(draw) -> FirstOrderHold:
    start = draw(st.floats(0.0, 1e5))
    gaps = draw(st.lists(st.floats(1e-3, 10.0), max_size=80))
    speeds = draw(st.lists(SPEEDS, min_size=len(gaps) + 1, max_size=len(gaps) + 1))
    return FirstOrderHold(start + np.cumsum([0.0, *gaps]), np.array(speeds))


@given(stamp=STAMPS)
def test_clock_is_the_one_of_rclpy_both_ways(stamp) -> None:
    message = Clock(clock=cv.stamp_to_ros(stamp))
    assert deserialize_message(serialised.clock_message(stamp), Clock) == message
    assert serialised.clock_stamp(serialize_message(message)) == stamp


@given(state=states(), stamp=STAMPS, frame=st.sampled_from(["world", "", "a", "robot/map"]))
def test_pose_is_the_one_of_rclpy_both_ways(state, stamp, frame) -> None:
    message = cv.pose_to_ros(state, stamp, 0.3, frame)
    written = serialised.pose_message(state, stamp, 0.3, frame)
    assert deserialize_message(written, PoseStamped) == message
    for given_as in (written, serialize_message(message), message):
        assert serialised.header_stamp(given_as) == stamp
        if frame in ("world", ""):
            read = serialised.pose_of_message(given_as)
            np.testing.assert_array_equal(read, cv.pose_from_ros(message))
        else:
            with pytest.raises(InvalidStateError, match=f"frame: given '{frame}'"):
                serialised.pose_of_message(given_as)


@given(hold=holds(), epoch=st.sampled_from([0, 1_700_000_000_123_456_789]))
def test_trajectory_is_the_one_of_rclpy_both_ways(hold, epoch) -> None:
    message = cv.hold_to_trajectory(hold, epoch)
    written = serialised.trajectory_message(hold, epoch)
    assert deserialize_message(written, JointTrajectory) == message
    for given_as in (written, serialize_message(message), message):
        read, stamp = serialised.hold_and_stamp(given_as, 0, epoch)
        expected = cv.hold_from_trajectory(message, 0, epoch)
        assert stamp == cv.stamp_from_ros(message.header.stamp)
        np.testing.assert_array_equal(read.times, expected.times)
        np.testing.assert_array_equal(read.speeds, expected.speeds)


@given(speeds=SPEEDS)
def test_speeds_are_those_of_rclpy_both_ways(speeds) -> None:
    message = Float64MultiArray(data=speeds.tolist())
    written = serialised.speeds_message(speeds)
    assert deserialize_message(written, Float64MultiArray) == message
    for given_as in (written, serialize_message(message), message):
        np.testing.assert_array_equal(serialised.speeds_of_message(given_as), speeds)


@given(values=st.tuples(SPEEDS, SPEEDS, SPEEDS), stamp=STAMPS)
def test_joint_states_are_those_of_rclpy_both_ways(values, stamp) -> None:
    message = cv.joint_states_to_ros(*values, stamp)
    written = serialised.joint_states_message(*values, stamp)
    assert deserialize_message(written, JointState) == message
    for given_as in (written, serialize_message(message), message):
        speeds, when = serialised.rotor_speeds_and_stamp(given_as)
        assert when == stamp
        np.testing.assert_array_equal(speeds, values[1])


@pytest.mark.parametrize("names", [[*cv.JOINT_NAMES, "wheel"], ["wheel", *cv.JOINT_NAMES[::-1]]])
def test_speeds_of_joint_states_with_other_joints_are_read(names) -> None:
    message = JointState(name=names, velocity=[1.0, 2.0, 3.0])
    message.header.frame_id = "base_link"
    speeds, _ = serialised.rotor_speeds_and_stamp(serialize_message(message))
    np.testing.assert_array_equal(speeds, cv.rotor_speeds_from_ros(message))


def test_speeds_of_joint_states_that_are_not_finite_are_none() -> None:
    raw = serialised.joint_states_message(np.zeros(2), np.array([1.0, np.nan]), np.zeros(2), 5)
    assert serialised.rotor_speeds_and_stamp(raw) == (None, 5)


def point(after: int = 0, **fields) -> JointTrajectoryPoint:
    made = JointTrajectoryPoint(velocities=[1.0, 2.0], **fields)
    made.time_from_start.sec = after
    return made


@pytest.mark.parametrize("points", [
    [point(positions=[5.0, 6.0]), point(1)],
    [point(), point(1, accelerations=[7.0, 8.0])],
    [point(effort=[1.0] * 3)],
])
@pytest.mark.parametrize("names", [cv.JOINT_NAMES, cv.JOINT_NAMES[::-1]])
def test_trajectory_of_another_layout_is_read_all_the_same(names, points) -> None:
    message = JointTrajectory(joint_names=list(names), points=points)
    message.header.frame_id = "base_link"
    read, _ = serialised.hold_and_stamp(serialize_message(message), 3, 1)
    expected = cv.hold_from_trajectory(message, 3, 1)
    np.testing.assert_array_equal(read.times, expected.times)
    np.testing.assert_array_equal(read.speeds, expected.speeds)


@pytest.mark.parametrize("message", [
    JointTrajectory(joint_names=list(cv.JOINT_NAMES)),
    JointTrajectory(joint_names=["other"], points=[point()]),
    JointTrajectory(joint_names=list(cv.JOINT_NAMES), points=[point(1), point(0)]),
    JointTrajectory(
        joint_names=list(cv.JOINT_NAMES), points=[JointTrajectoryPoint(velocities=[1.0])]
    ),
    JointTrajectory(
        joint_names=list(cv.JOINT_NAMES), points=[JointTrajectoryPoint(velocities=[1.0, np.nan])]
    ),
])
def test_invalid_trajectory_is_refused_as_its_object_is(message) -> None:
    with pytest.raises(InvalidInputError) as expected:
        cv.hold_from_trajectory(message, 0)
    with pytest.raises(InvalidInputError) as error:
        serialised.hold_and_stamp(serialize_message(message), 0)
    assert str(error.value) == str(expected.value)


@pytest.mark.parametrize("number", [np.nan, np.inf, 1e7])
def test_invalid_pose_is_refused_as_its_object_is(number) -> None:
    message = PoseStamped()
    message.pose.position.x, message.pose.orientation.w = number, 1.0
    with pytest.raises(InvalidStateError) as expected:
        cv.framed_pose_from_ros(message)
    with pytest.raises(InvalidStateError) as error:
        serialised.pose_of_message(serialize_message(message))
    assert str(error.value) == str(expected.value)


def test_speeds_with_dimensions_or_of_another_number_are_read() -> None:
    message = Float64MultiArray(data=[1.0, 2.0, 3.0])
    message.layout.dim = [MultiArrayDimension(label="rotors", size=3, stride=3)]
    np.testing.assert_array_equal(
        serialised.speeds_of_message(serialize_message(message)), [1.0, 2.0, 3.0]
    )
    assert serialised.speeds_of_message(serialize_message(Float64MultiArray())).size == 0


def big_endian_pose(x: float, stamp: int) -> bytes:
    head = b"\x00\x00\x00\x00" + struct.pack(">iI", *divmod(stamp, NANOSECONDS))
    name = struct.pack(">I", 6) + b"world\x00" + bytes(6)
    return head + name + struct.pack(">7d", x, 2.0, 0.3, 0.0, 0.0, 0.0, 1.0)


def test_pose_of_a_big_endian_machine_is_read() -> None:
    raw = big_endian_pose(1.5, 12_000_000_034)
    assert serialised.header_stamp(raw) == 12_000_000_034
    np.testing.assert_array_equal(serialised.pose_of_message(raw), [1.5, 2, 1, 0, 0, 0])


@pytest.mark.parametrize("cut", [0, 3, 12, 20, 60])
def test_bytes_that_are_no_message_are_refused(cut) -> None:
    pose = serialised.pose_message(np.array([0.0, 0, 1, 0, 0, 0]), 1, 0.3)[:cut]
    with pytest.raises(InvalidStateError, match=r"PoseStamped: given b'.*, expected a message"):
        serialised.pose_of_message(pose)
    hold = FirstOrderHold.constant(0.0, np.zeros(2))
    for message, read in (
        (serialised.trajectory_message(hold), lambda raw: serialised.hold_and_stamp(raw, 0)),
        (
            serialised.joint_states_message(*np.zeros((3, 2)), 0),
            serialised.rotor_speeds_and_stamp,
        ),
        (serialised.speeds_message(np.zeros(2))[:-4], serialised.speeds_of_message),
    ):
        with pytest.raises(InvalidInputError, match=r"given b'.*, expected a message of"):
            read(message[:cut])
