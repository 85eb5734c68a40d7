# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages written and read in their serialised form or as objects, compared with rclpy's."""

import math
import struct
from collections.abc import Callable

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros import cdr, cdr_messages
from sphere_nmpc.ros import messages as ms

TURNED = np.array([1.0, 2.0, 0.5, -0.5, 0.7, 0.1])
AT_ORIGIN = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
EPOCHS = st.sampled_from([0, 1_700_000_000_123_456_789])
STAMPS = st.integers(0, 2_000_000_000_000_000_000)
SPEEDS = st.tuples(*[st.floats(-100.0, 100.0)] * 2).map(np.array)


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


@given(stamp=STAMPS, speeds=SPEEDS)
def test_clock_and_speeds_are_those_of_rclpy_both_ways(stamp, speeds) -> None:
    clock, commands = Clock(clock=ms.stamp_to_ros(stamp)), Float64MultiArray(data=speeds.tolist())
    assert deserialize_message(cdr_messages.clock_message(stamp), Clock) == clock
    assert deserialize_message(cdr_messages.speeds_message(speeds), Float64MultiArray) == commands
    assert cdr.clock_stamp(serialize_message(clock)) == stamp
    assert cdr.read(serialize_message(commands), cdr.Numbers).numbers.tolist() == speeds.tolist()
    commands.data = [1.0, 2.0, 3.0]
    commands.layout.dim = [MultiArrayDimension(label="rotors", size=3, stride=3)]
    assert cdr.read(serialize_message(commands), cdr.Numbers).numbers.tolist() == [1.0, 2.0, 3.0]


@given(state=states(), stamp=STAMPS, frame=st.sampled_from(["world", "", "a", "robot/map"]))
def test_pose_is_the_one_of_rclpy_both_ways(state, stamp, frame) -> None:
    message = ms.pose_to_ros(state, stamp, 0.3, frame)
    turn = message.pose.orientation
    assert (turn.w, turn.x, turn.y, turn.z) == tuple(state[2:])
    written = cdr_messages.pose_message(state, stamp, 0.3, frame)
    assert deserialize_message(written, PoseStamped) == message
    for given_as in (written, serialize_message(message)):
        pose = cdr.read(given_as, cdr.Pose)
        assert pose.stamp == stamp
        if frame in ("world", ""):
            read = pose.in_frame("world")
            np.testing.assert_allclose(read, state, rtol=0.0, atol=4e-16)
            np.testing.assert_array_equal(read, ms.framed_pose_from_ros(message))
        else:
            with pytest.raises(InvalidStateError, match=f"frame: given '{frame}', .* 'world'"):
                pose.in_frame("world")


@given(
    values=st.tuples(*[st.floats(-100.0, 100.0)] * 6), stamp=STAMPS,
    frame=st.sampled_from(["imu", "second/imu"]),
)
def test_imu_is_the_one_of_rclpy_both_ways_and_has_no_orientation(values, stamp, frame) -> None:
    rate, force = np.array(values[:3]), np.array(values[3:])
    written = cdr_messages.imu_message(rate, force, np.array([0.1, 0.2]), stamp, frame)
    message = Imu(
        angular_velocity=Vector3(x=rate[0], y=rate[1], z=rate[2]),
        angular_velocity_covariance=np.diag([0.1**2] * 3).ravel(),
        linear_acceleration=Vector3(x=force[0], y=force[1], z=force[2]),
        linear_acceleration_covariance=np.diag([0.2**2] * 3).ravel(),
        orientation_covariance=[-1.0] + [0.0] * 8,
    )
    message.header.stamp, message.header.frame_id = ms.stamp_to_ros(stamp), frame
    assert deserialize_message(written, Imu) == message
    read = cdr.read(serialize_message(message), cdr.Imu)
    assert (read.stamp, read.frame, *read.rate, *read.force) == (stamp, frame, *values)


@given(hold=holds(), epoch=EPOCHS, swapped=st.booleans())
def test_trajectory_is_read_as_the_hold_that_was_written(hold, epoch, swapped) -> None:
    written = cdr_messages.trajectory_message(hold, np.array([3.0, -4.0]), epoch)
    message = deserialize_message(written, JointTrajectory)
    if swapped:
        message.joint_names = message.joint_names[::-1]
        for point in message.points:
            point.positions = point.positions[::-1]
            point.velocities = point.velocities[::-1]
    for given_as in (written, serialize_message(message)):
        read, stamp = cdr.hold_and_stamp(given_as, 0, epoch)
        assert stamp == ms.stamp_from_ros(message.header.stamp)
        np.testing.assert_allclose(read.times, hold.times, rtol=0.0, atol=2e-9)
        np.testing.assert_array_equal(read.speeds, hold.speeds)


@given(values=st.tuples(SPEEDS, SPEEDS, SPEEDS), stamp=STAMPS)
def test_joint_states_are_those_of_rclpy_both_ways(values, stamp) -> None:
    written = cdr_messages.joint_states_message(*values, stamp)
    message = deserialize_message(written, JointState)
    assert message.name == list(cdr.JOINT_NAMES)
    speeds, when = cdr.rotor_speeds_and_stamp(written)
    assert when == stamp
    np.testing.assert_array_equal(speeds, values[1])
    for name in ("name", "position", "velocity", "effort"):
        setattr(message, name, getattr(message, name)[::-1])
    read = cdr.read(serialize_message(message), cdr.Joints)
    np.testing.assert_array_equal(read.of_rotors(), values)


@pytest.mark.parametrize(
    ("names", "speeds", "read"),
    [
        (["wheel", "rotor_2_joint", "rotor_1_joint"], [9.0, 2.0, 1.0], [1.0, 2.0]),
        (["rotor_1_joint"], [1.0], None),
        (["rotor_1_joint", "rotor_2_joint"], [], None),
        (["rotor_1_joint", "rotor_2_joint"], [1.0, math.nan], None),
    ],
)
def test_rotors_are_found_by_name_and_need_finite_speeds(names, speeds, read) -> None:
    message = JointState(name=names, velocity=speeds)
    found, _ = cdr.rotor_speeds_and_stamp(serialize_message(message))
    assert found is read if read is None else found.tolist() == read


def point(after: int = 0, **fields) -> JointTrajectoryPoint:
    made = JointTrajectoryPoint(**{"velocities": [1.0, 2.0], **fields})
    made.time_from_start.sec = after
    return made


@pytest.mark.parametrize("points", [
    [point(positions=[5.0, 6.0]), point(1)],
    [point(), point(1, accelerations=[7.0, 8.0])],
    [point(effort=[1.0] * 3)],
])
def test_trajectory_of_another_layout_is_read_all_the_same(points) -> None:
    message = JointTrajectory(joint_names=list(cdr.JOINT_NAMES), points=points)
    for frame in ("", "base_link"):
        message.header.frame_id = frame
        read, _ = cdr.hold_and_stamp(serialize_message(message), 2 * NANOSECONDS)
        assert read.times.tolist() == [2.0, 3.0][: len(points)], "stamp 0 means now"
        np.testing.assert_array_equal(read.speeds, [[1.0, 2.0]] * len(points))


@pytest.mark.parametrize(
    ("names", "points", "words"),
    [
        (["rotor_1_joint", "wheel"], [point()], "given.*wheel.*expected"),
        (["rotor_1_joint"] * 2, [point()], "given.*expected"),
        (cdr.JOINT_NAMES, [point(velocities=[1.0])], r"velocities .*: given \[1\], expected one"),
        (cdr.JOINT_NAMES, [point(velocities=[1.0, math.nan])], "nan.*expected finite numbers"),
        (cdr.JOINT_NAMES, [point(1), point(0)], "strictly rising"),
    ],
    ids=["unknown", "twice", "short", "nan", "times"],
)
def test_trajectory_that_is_wrong_is_refused_with_what_was_given(names, points, words) -> None:
    message = JointTrajectory(joint_names=list(names), points=points)
    with pytest.raises(InvalidInputError, match=words):
        cdr.hold_and_stamp(serialize_message(message), 0)


def test_pose_of_a_big_endian_machine_is_read() -> None:
    head = b"\x00\x00\x00\x00" + struct.pack(">iI", 12, 34)
    name = struct.pack(">I", 6) + b"world\x00" + bytes(6)
    raw = head + name + struct.pack(">7d", 1.5, 2.0, 0.3, 0.0, 0.0, 0.0, 1.0)
    pose = cdr.read(raw, cdr.Pose)
    assert pose.stamp == 12_000_000_034
    np.testing.assert_array_equal(pose.in_frame("world"), [1.5, 2, 1, 0, 0, 0])


@pytest.mark.parametrize("cut", [0, 3, 15, 60])
@pytest.mark.parametrize(
    ("message", "read"),
    [
        (cdr_messages.pose_message(AT_ORIGIN, 1, 0.3), lambda raw: cdr.read(raw, cdr.Pose)),
        (
            cdr_messages.trajectory_message(
                FirstOrderHold.constant(0.0, np.zeros(2)), np.zeros(2)
            ),
            lambda raw: cdr.hold_and_stamp(raw, 0),
        ),
        (cdr_messages.joint_states_message(*np.zeros((3, 2)), 0), cdr.rotor_speeds_and_stamp),
        (
            cdr_messages.speeds_message(np.zeros(2))[:-4],
            lambda raw: cdr.read(raw, cdr.Numbers),
        ),
    ],
    ids=["pose", "trajectory", "joint states", "speeds"],
)
def test_bytes_that_are_no_message_are_refused(message, read: Callable, cut) -> None:
    with pytest.raises((InvalidStateError, InvalidInputError), match=r"given b'.*, expected a m"):
        read(message[:cut])


def test_odometry_twist_is_in_the_body_frame() -> None:
    velocity, rate = np.array([0.3, -0.7, 0.0]), np.array([1.0, 2.0, 3.0])
    twist = ms.odometry_to_ros(TURNED, velocity, rate, 7, 0.3).twist.twist
    linear = np.array([twist.linear.x, twist.linear.y, twist.linear.z])
    to_world = Rotation.from_quat(TURNED[[3, 4, 5, 2]])
    np.testing.assert_allclose(to_world.apply(linear), velocity, atol=1e-12)
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == tuple(rate)
