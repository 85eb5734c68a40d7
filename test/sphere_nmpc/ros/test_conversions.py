# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Round trips between arrays and messages, and messages that are refused."""

import math

import numpy as np
import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.ros import conversions as cv
from sphere_sim.scenario.scenarios import draw_scenarios

NANOSECOND = 1e-9
RADIUS = 0.3
STATES = [scenario.start for scenario in draw_scenarios(20, seed=1)]
EPOCH = 1_795_000_000_123_456_789


def trajectory(names, *points, stamp=0) -> JointTrajectory:
    """Return a trajectory with points (time_from_start [s], velocities)."""
    message = JointTrajectory(joint_names=list(names))
    message.header.stamp = cv.stamp_to_ros(stamp)
    for after, velocities in points:
        start = Duration(sec=int(after), nanosec=round(after % 1 * 1e9))
        message.points.append(
            JointTrajectoryPoint(velocities=list(velocities), time_from_start=start)
        )
    return message


@given(st.integers(min_value=0, max_value=2**31 * 10**9 - 1))
def test_stamp_returns_to_the_nanosecond(stamp) -> None:
    assert cv.stamp_from_ros(cv.stamp_to_ros(stamp)) == stamp


@pytest.mark.parametrize("state", STATES)
def test_pose_returns_the_same_state(state) -> None:
    message = cv.pose_to_ros(state, 1_500_000_000, RADIUS)
    assert message.header.stamp == Time(sec=1, nanosec=500_000_000)
    assert message.header.frame_id == "world"
    assert message.pose.position.z == RADIUS
    np.testing.assert_allclose(cv.pose_from_ros(message), state, atol=1e-15)


METRES = st.floats(-1e6, 1e6)
TURNS = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


@given(place=st.tuples(METRES, METRES), turn=TURNS, frame=st.sampled_from(["", "world"]))
def test_any_state_returns_from_its_pose_through_the_middleware(place, turn, frame) -> None:
    state = np.array([*place, *(np.array(turn) / np.linalg.norm(turn))])
    sent = serialize_message(cv.pose_to_ros(state, 7, RADIUS, frame))
    back = cv.framed_pose_from_ros(deserialize_message(sent, PoseStamped))
    np.testing.assert_allclose(back, state, rtol=0.0, atol=4e-16)
    np.testing.assert_array_equal(back[:2], state[:2])


@settings(max_examples=60)
@given(
    gaps=st.lists(st.integers(1, 10**10), min_size=1, max_size=6),
    speeds=st.lists(st.floats(-1e3, 1e3), min_size=14, max_size=14),
    start=st.integers(0, 10**13), epoch=st.sampled_from([0, EPOCH]), swapped=st.booleans(),
)
def test_any_hold_returns_from_its_trajectory(gaps, speeds, start, epoch, swapped) -> None:
    times = np.cumsum([start, *gaps]) * NANOSECOND
    hold = FirstOrderHold(times, np.reshape(speeds, (-1, 2))[: times.size])
    message = cv.hold_to_trajectory(hold, epoch)
    if swapped:
        message.joint_names = list(reversed(message.joint_names))
        for point in message.points:
            point.velocities = list(reversed(point.velocities))
    sent = deserialize_message(serialize_message(message), JointTrajectory)
    # Stamp 0 means now, which is then when the hold begins.
    back = cv.hold_from_trajectory(sent, now=start, epoch=epoch)
    np.testing.assert_allclose(back.times, hold.times, rtol=0.0, atol=2.0 * NANOSECOND)
    np.testing.assert_array_equal(back.speeds, hold.speeds)


def test_pose_swaps_the_scalar_to_the_end() -> None:
    message = cv.pose_to_ros(np.array([1.0, 2.0, 0.1, 0.7, 0.5, 0.5]), 0, RADIUS)
    turn = message.pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == (0.7, 0.5, 0.5, 0.1)


@pytest.mark.parametrize("field, value", [("x", math.nan), ("w", math.inf), ("w", 2.0)])
def test_pose_that_is_no_state_is_refused(field, value) -> None:
    message = cv.pose_to_ros(STATES[0], 0, RADIUS)
    setattr(message.pose.orientation, field, value)
    with pytest.raises(InvalidStateError):
        cv.pose_from_ros(message)


@pytest.mark.parametrize("frame, accepted", [("", True), ("world", True), ("map", False)])
def test_framed_pose_needs_the_world_or_no_frame(frame, accepted) -> None:
    message = cv.pose_to_ros(STATES[0], 0, RADIUS, frame)
    if accepted:
        np.testing.assert_allclose(cv.framed_pose_from_ros(message), STATES[0], atol=1e-15)
    else:
        with pytest.raises(InvalidStateError, match="given 'map', expected 'world'"):
            cv.framed_pose_from_ros(message)


def test_transform_agrees_with_the_pose() -> None:
    pose = cv.pose_to_ros(STATES[0], 5, RADIUS)
    transform = cv.transform_from_pose(pose)
    assert transform.header == pose.header and transform.child_frame_id == "base_link"
    shift, place = transform.transform.translation, pose.pose.position
    assert (shift.x, shift.y, shift.z) == (place.x, place.y, place.z)
    assert transform.transform.rotation == pose.pose.orientation


@pytest.mark.parametrize("state", STATES)
def test_odometry_twist_is_in_the_body_frame(state) -> None:
    velocity, rate = np.array([0.3, -0.7, 0.0]), np.array([1.0, 2.0, 3.0])
    message = cv.odometry_to_ros(state, velocity, rate, 7, RADIUS)
    assert message.child_frame_id == "base_link"
    twist = message.twist.twist
    w, x, y, z = state[2:]
    to_world = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    linear = np.array([twist.linear.x, twist.linear.y, twist.linear.z])
    np.testing.assert_allclose(to_world @ linear, velocity, atol=1e-12)
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == tuple(rate)


def test_joint_states_return_in_whatever_order_they_are_named() -> None:
    parts = np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 6.0])
    message = cv.joint_states_to_ros(*parts, stamp=5)
    for name in ("name", "position", "velocity", "effort"):
        setattr(message, name, list(reversed(getattr(message, name))))
    for part, expected in zip(cv.joint_states_from_ros(message), parts, strict=True):
        np.testing.assert_array_equal(part, expected)


@pytest.mark.parametrize("epoch", [0, EPOCH])
def test_hold_returns_within_a_nanosecond(epoch) -> None:
    hold = FirstOrderHold(
        np.array([3.5, 4.0, 4.123456789, 4.5]),
        np.array([[0.0, 1.0], [100.0, -100.0], [0.1 + 0.2, 1 / 3], [0.0, 0.0]]),
    )
    message = cv.hold_to_trajectory(hold, epoch)
    assert cv.stamp_from_ros(message.header.stamp) == epoch + 3_500_000_000
    back = cv.hold_from_trajectory(message, now=0, epoch=epoch)
    np.testing.assert_allclose(back.times, hold.times, atol=NANOSECOND)
    np.testing.assert_array_equal(back.speeds, hold.speeds)


def test_trajectory_with_stamp_zero_starts_now() -> None:
    message = trajectory(cv.JOINT_NAMES, (0.0, (1.0, 2.0)), (0.5, (3.0, 4.0)))
    assert cv.hold_from_trajectory(message, now=2_000_000_000).start == 2.0


def test_trajectory_is_matched_by_name() -> None:
    message = trajectory(reversed(cv.JOINT_NAMES), (0.0, (1.0, 2.0)))
    np.testing.assert_array_equal(cv.hold_from_trajectory(message, 0).speeds, [[2.0, 1.0]])


@pytest.mark.parametrize(
    "message, words",
    [
        (trajectory(("rotor_1_joint", "wheel"), (0.0, (1.0, 2.0))), "given.*wheel.*expected"),
        (trajectory(("rotor_1_joint",), (0.0, (1.0,))), "given.*expected.*rotor_2_joint"),
        (trajectory((*cv.JOINT_NAMES, "third"), (0.0, (1.0, 2.0, 3.0))), "given.*third"),
        (trajectory(("rotor_1_joint",) * 2, (0.0, (1.0, 2.0))), "given.*expected"),
        (trajectory(cv.JOINT_NAMES), r"velocities .*: given \[\], expected one"),
        (trajectory(cv.JOINT_NAMES, (0.0, (1.0,))), r"velocities .*: given \[1\], expected one"),
        (trajectory(cv.JOINT_NAMES, (0.0, (1.0, math.nan))), "nan.*expected finite numbers"),
        (trajectory(cv.JOINT_NAMES, (0.5, (1.0, 2.0)), (0.5, (1.0, 2.0))), "strictly rising"),
    ],
    ids=["unknown", "missing", "extra", "twice", "empty", "short", "nan", "times"],
)
def test_trajectory_that_is_wrong_is_refused_with_what_was_given(message, words) -> None:
    with pytest.raises(InvalidInputError, match=words):
        cv.hold_from_trajectory(message, now=0)


def test_path_stamps_each_pose() -> None:
    path = cv.path_to_ros([1.0, 1.5], np.array(STATES[:2]), RADIUS)
    assert [cv.stamp_from_ros(pose.header.stamp) for pose in path.poses] == [10**9, 15 * 10**8]
    assert path.header == path.poses[0].header
    np.testing.assert_allclose(cv.pose_from_ros(path.poses[1]), STATES[1], atol=1e-15)
