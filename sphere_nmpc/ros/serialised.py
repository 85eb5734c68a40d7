# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Serialised form (CDR) of the messages of the control loop, written and read without objects.

At 500 Hz message objects take longer than a solve: rclpy makes each of them field by field. A
message of another layout than the usual one, such as one of other joints or from a big-endian
machine, is read by way of its object instead, with the same result.
"""

import struct
from functools import cache
from math import isfinite
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector, make_state
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.conversions import (
    JOINT_NAMES,
    WORLD_FRAME,
    framed_pose_from_ros,
    hold_from_trajectory,
    rotor_speeds_from_ros,
    stamp_from_ros,
    stamp_of,
)

_PLAIN = b"\x00\x01\x00\x00"
"""Encapsulation: plain CDR with the least significant byte first."""
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_BEGIN = len(_PLAIN)
"""Where the message begins; its numbers are aligned to their size from here."""
_BODY = _BEGIN + _STAMP.size
"""Where a message with a header continues after its stamp."""


def _text(*words: str) -> bytes:
    """Return strings as CDR has them: length, characters, a zero byte, and padding to four."""
    parts = [word.encode() + b"\x00" for word in words]
    return b"".join(_LENGTH.pack(len(part)) + part + bytes(-len(part) % 4) for part in parts)


_POSE = struct.Struct("<7d")
_JOINTS = _text("") + _LENGTH.pack(len(JOINT_NAMES)) + _text(*JOINT_NAMES)
"""From the stamp to the values: no frame, and the names of the joints."""
_VALUES = _BODY + len(_JOINTS)
_POINTS = _VALUES + _LENGTH.size
_POINT = np.dtype([
    ("before", "<u8"), ("speeds", "<f8", (2,)), ("after", "<u8"),
    ("seconds", "<i4"), ("nanoseconds", "<u4"),
])
"""Point of a trajectory. Before and after the speeds are the numbers of positions and velocities,
and of accelerations and efforts."""
_VELOCITIES_ONLY = len(JOINT_NAMES) << 32
_STATES = struct.Struct("<I2dI4x2dI4x2d")
_SPEEDS_COUNTS = _PLAIN + struct.pack("<3I", 0, 0, len(JOINT_NAMES))
_SPEEDS_PADDING = bytes(4)
_SPEEDS = struct.Struct("<2d")


def clock_message(stamp: int) -> bytes:
    """Return the Clock message of a stamp [ns]."""
    return _PLAIN + _STAMP.pack(*divmod(stamp, NANOSECONDS))


def clock_stamp(raw: bytes) -> int:
    """Return the stamp [ns] of a Clock message.

    Raises
    ------
    InvalidInputError
        If it cannot be read, or is before 0, which a ROS clock cannot be set to.
    """
    stamp = _stamp(raw) if _is_plain(raw) else stamp_from_ros(message_object(raw, Clock).clock)
    if stamp < 0:
        raise InvalidInputError("clock", stamp / NANOSECONDS, "0 or more [s]")
    return stamp


def pose_message(
    state: Vector, stamp: int, shell_radius: float, frame: str = WORLD_FRAME
) -> bytes:
    """Return a PoseStamped; see `sphere_nmpc.ros.conversions.pose_to_ros`."""
    name = _text(frame)
    x, y, qw, qx, qy, qz = state.tolist()
    numbers = _POSE.pack(x, y, shell_radius, qx, qy, qz, qw)
    return clock_message(stamp) + name + bytes(-len(name) % 8) + numbers


def header_stamp(message: Any) -> int:
    """Return the stamp [ns] of a PoseStamped, given serialised or as object.

    Raises
    ------
    InvalidStateError
        If it cannot be read.
    """
    if _is_plain(message):
        return _stamp(message)
    return stamp_from_ros(_pose_object(message).header.stamp)


def pose_of_message(message: Any, frame: str = WORLD_FRAME) -> Vector:
    """Return the state, shape (6,), of a PoseStamped in the given frame or without one.

    It is given serialised or as object.

    Raises
    ------
    InvalidStateError
        See `sphere_nmpc.ros.conversions.framed_pose_from_ros`; also if it cannot be read.
    """
    at = _numbers_of_pose(message, frame) if _is_plain(message) else None
    if at is None:
        return framed_pose_from_ros(_pose_object(message), frame)
    x, y, _, qx, qy, qz, qw = _POSE.unpack_from(message, at)
    return make_state((x, y), (qw, qx, qy, qz))


def trajectory_message(hold: FirstOrderHold, epoch: int = 0) -> bytes:
    """Return a JointTrajectory; see `sphere_nmpc.ros.conversions.hold_to_trajectory`."""
    start = stamp_of(hold.start, epoch)
    # As `stamp_of`, for all knots.
    after = np.rint(hold.times * NANOSECONDS).astype(np.int64) - (start - epoch)
    points = np.zeros(hold.times.size, _POINT)
    points["before"] = _VELOCITIES_ONLY
    points["speeds"] = hold.speeds
    points["seconds"], points["nanoseconds"] = np.divmod(after, NANOSECONDS)
    count = _LENGTH.pack(hold.times.size)
    return b"".join((clock_message(start), _JOINTS, count, points.tobytes()))


def hold_and_stamp(message: Any, now: int, epoch: int = 0) -> tuple[FirstOrderHold, int]:
    """Return hold and stamp [ns] of a JointTrajectory, given serialised or as object.

    See `sphere_nmpc.ros.conversions.hold_from_trajectory` for the other arguments and errors; one
    that cannot be read is an `InvalidInputError`, too.
    """
    points = _points(message) if _has_joints(message) else None
    if points is None:
        read = message_object(message, JointTrajectory)
        return hold_from_trajectory(read, now, epoch), stamp_from_ros(read.header.stamp)
    stamp = _stamp(message)
    after = points["seconds"].astype(np.int64) * NANOSECONDS + points["nanoseconds"]
    times = (after + ((stamp or now) - epoch)) / NANOSECONDS
    return FirstOrderHold(times, points["speeds"]), stamp


def speeds_message(speeds: Vector) -> bytes:
    """Return rotor speeds [rad/s], shape (2,), as a Float64MultiArray."""
    return _SPEEDS_COUNTS + _SPEEDS_PADDING + _SPEEDS.pack(*speeds.tolist())


def speeds_of_message(message: Any) -> Vector:
    """Return the numbers of a Float64MultiArray, shape (K,), given serialised or as object.

    Raises
    ------
    InvalidInputError
        If it cannot be read.
    """
    at = len(_SPEEDS_COUNTS) + len(_SPEEDS_PADDING)
    is_usual = isinstance(message, bytes) and message.startswith(_SPEEDS_COUNTS)
    if is_usual and len(message) >= at + _SPEEDS.size:
        return np.array(_SPEEDS.unpack_from(message, at))
    return np.array(message_object(message, Float64MultiArray).data, dtype=float)


def joint_states_message(angles: Vector, speeds: Vector, torques: Vector, stamp: int) -> bytes:
    """Return a JointState; see `sphere_nmpc.ros.conversions.joint_states_to_ros`."""
    both = len(JOINT_NAMES)
    values = _STATES.pack(both, *angles.tolist(), both, *speeds.tolist(), both, *torques.tolist())
    return clock_message(stamp) + _JOINTS + values


def rotor_speeds_and_stamp(message: Any) -> tuple[Vector | None, int]:
    """Return rotor speeds [rad/s], shape (2,), and stamp [ns] of a JointState.

    It is given serialised or as object. The speeds are None as those of
    `sphere_nmpc.ros.conversions.rotor_speeds_from_ros` are.

    Raises
    ------
    InvalidInputError
        If it cannot be read.
    """
    if _has_joints(message) and len(message) >= _VALUES + _STATES.size:
        numbers = _STATES.unpack_from(message, _VALUES)
        if numbers[0::3] == (len(JOINT_NAMES),) * 3:
            speeds = numbers[4:6]
            return np.array(speeds) if all(map(isfinite, speeds)) else None, _stamp(message)
    read = message_object(message, JointState)
    return rotor_speeds_from_ros(read), stamp_from_ros(read.header.stamp)


def _is_plain(message: Any) -> bool:
    """Return whether a message is given serialised, in plain CDR and with a stamp at least."""
    return isinstance(message, bytes) and message.startswith(_PLAIN) and len(message) >= _BODY


def _has_joints(message: Any) -> bool:
    """Return whether a serialised message has no frame and the joints in their usual order."""
    return _is_plain(message) and message.startswith(_JOINTS, _BODY)


def _stamp(raw: bytes) -> int:
    seconds, nanoseconds = _STAMP.unpack_from(raw, _BEGIN)
    stamp: int = seconds * NANOSECONDS + nanoseconds
    return stamp


@cache
def _accepted(frame: str) -> list[tuple[bytes, int]]:
    """Return no frame and `frame` as CDR has them, and where the numbers of a pose begin."""
    found = []
    for name in ("", frame):
        text = _text(name)
        found.append((text[: _LENGTH.size + len(name.encode()) + 1],
                      _BODY + len(text) + -len(text) % 8))
    return found


def _numbers_of_pose(raw: bytes, frame: str) -> int | None:
    """Return where the numbers of a pose begin, None where its frame is not an accepted one."""
    for begin, numbers in _accepted(frame):
        # The bytes between are padding, in which there may be anything.
        if raw.startswith(begin, _BODY) and len(raw) >= numbers + _POSE.size:
            return numbers
    return None


def _points(raw: bytes) -> Any:
    """Return the points of a trajectory with velocities only, None where it has others."""
    if len(raw) < _POINTS:
        return None
    (count,) = _LENGTH.unpack_from(raw, _VALUES)
    if not 0 < count <= (len(raw) - _POINTS) // _POINT.itemsize:
        return None
    points = np.frombuffer(raw, _POINT, count, _POINTS)
    usual = (points["before"] == _VELOCITIES_ONLY).all() and not points["after"].any()
    return points if usual else None


def _pose_object(message: Any) -> Any:
    try:
        return message_object(message, PoseStamped)
    except InvalidInputError as error:
        raise InvalidStateError(error.name, error.given, error.expected) from None


def message_object(message: Any, kind: Any) -> Any:
    """Return the object of a message, which may be given as such.

    Raises
    ------
    InvalidInputError
        If it cannot be read.
    """
    if not isinstance(message, bytes):
        return message
    try:
        return deserialize_message(message, kind)
    except Exception:  # the middleware's own types of error are private to it
        raise InvalidInputError(kind.__name__, message, "a message of this type") from None
