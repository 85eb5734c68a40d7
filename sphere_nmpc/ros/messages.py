# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""ROS messages from and to arrays and stamps; wxyz becomes xyzw here only.

Stamps are whole nanoseconds on this side, so that they compare exactly; control times are seconds
since `epoch`, a stamp [ns] that is 0 in simulated time.

Clock, pose, trajectory and speeds are written and read in their serialised form (CDR), as
``bytes``, and joint states are written so. They pass at up to 2000 Hz, and rclpy makes message
objects field by field: with objects a pose or a trajectory of ten knots takes ten times as long to
write and eight times to read, a clock message a hundred times. One of another layout than the
usual one, such as with further joints or from a big-endian machine, is read by way of its object,
with the same result. All other messages are objects of rclpy, as they are rare or for displays.

What cannot be read or used raises an `InvalidStateError`, where it is a pose, or an
`InvalidInputError`.
"""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state, upright_state
from sphere_nmpc.quantity import NANOSECONDS

JOINT_NAMES = ("rotor_1_joint", "rotor_2_joint")
"""Names of the rotors about body x and body y."""
WORLD_FRAME = "world"
BODY_FRAME = "base_link"

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
_POINTS = _BODY + len(_JOINTS) + _LENGTH.size
_POINT = np.dtype([
    ("before", "<u8"), ("speeds", "<f8", (2,)), ("after", "<u8"),
    ("seconds", "<i4"), ("nanoseconds", "<u4"),
])
"""Point of a trajectory. Before and after the speeds are the numbers of positions and velocities,
and of accelerations and efforts."""
_VELOCITIES_ONLY = len(JOINT_NAMES) << 32
_STATES = struct.Struct("<I2dI4x2dI4x2d")
_SPEEDS_HEAD = _PLAIN + struct.pack("<3I", 0, 0, len(JOINT_NAMES))
_SPEEDS = struct.Struct("<4x2d")


def stamp_to_ros(stamp: int) -> Time:
    """Return a stamp [ns] as a message."""
    seconds, rest = divmod(stamp, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def stamp_from_ros(message: Any) -> int:
    """Return a Time or Duration message as whole nanoseconds."""
    return int(message.sec) * NANOSECONDS + int(message.nanosec)


def seconds(stamp: int, epoch: int = 0) -> float:
    """Return a stamp [ns] as control time [s] since `epoch` [ns]."""
    return (stamp - epoch) / NANOSECONDS


def stamp_of(time: float, epoch: int = 0) -> int:
    """Return the stamp [ns] of a control time [s] since `epoch` [ns]."""
    return epoch + round(time * NANOSECONDS)


def clock_message(stamp: int) -> bytes:
    """Return the Clock message of a stamp [ns]."""
    return _PLAIN + _STAMP.pack(*divmod(stamp, NANOSECONDS))


def clock_stamp(raw: bytes) -> int:
    """Return the stamp [ns] of a Clock message, of 0 or more, as a ROS clock has it."""
    stamp = _stamp(raw)
    if stamp is None:
        stamp = stamp_from_ros(message_object(raw, Clock).clock)
    if stamp < 0:
        raise InvalidInputError("clock", stamp / NANOSECONDS, "0 or more [s]")
    return stamp


def pose_message(
    state: Vector, stamp: int, shell_radius: float, frame: str = WORLD_FRAME
) -> bytes:
    """Return a state, shape (6,), as the PoseStamped of a sphere resting on the plane z = 0.

    `stamp` is its time [ns], `shell_radius` the height of the centre [m].
    """
    name = _text(frame)
    x, y, qw, qx, qy, qz = state.tolist()
    numbers = _POSE.pack(x, y, shell_radius, qx, qy, qz, qw)
    return clock_message(stamp) + name + bytes(-len(name) % 8) + numbers


def header_stamp(raw: bytes) -> int:
    """Return the stamp [ns] of a serialised PoseStamped."""
    stamp = _stamp(raw)
    return stamp_from_ros(_pose_object(raw).header.stamp) if stamp is None else stamp


def pose_of_message(raw: bytes, frame: str = WORLD_FRAME) -> Vector:
    """Return the state, shape (6,), of a serialised PoseStamped; see `framed_pose_from_ros`."""
    begin = _BODY + _LENGTH.size
    if raw.startswith(_PLAIN) and len(raw) >= begin:
        end = begin + _LENGTH.unpack_from(raw, _BODY)[0]
        at = end + (_BEGIN - end) % 8
        if len(raw) >= at + _POSE.size and raw[begin : end - 1] in (b"", frame.encode()):
            x, y, _, qx, qy, qz, qw = _POSE.unpack_from(raw, at)
            return make_state((x, y), (qw, qx, qy, qz))
    return framed_pose_from_ros(_pose_object(raw), frame)


def pose_to_ros(
    state: Vector, stamp: int, shell_radius: float, frame: str = WORLD_FRAME
) -> PoseStamped:
    """Return the message object of a pose; see `pose_message`."""
    message = PoseStamped()
    message.header.stamp = stamp_to_ros(stamp)
    message.header.frame_id = frame
    _fill_pose(message.pose, state, shell_radius)
    return message


def pose_from_ros(message: Any) -> Vector:
    """Return the state, shape (6,), of a PoseStamped; its height and frame are ignored."""
    place, turn = message.pose.position, message.pose.orientation
    return make_state((place.x, place.y), (turn.w, turn.x, turn.y, turn.z))


def framed_pose_from_ros(message: Any, frame: str = WORLD_FRAME) -> Vector:
    """Return the state, shape (6,), of a PoseStamped in the given frame or without one."""
    _check_frame(message, frame)
    return pose_from_ros(message)


def framed_poses_from_ros(
    messages: Sequence[Any], common: str, frame: str = WORLD_FRAME
) -> list[Vector]:
    """Return the states of PoseStampeds, each as `framed_pose_from_ros`.

    Those without a frame are in the `common` one, that of their list, which they are given.
    """
    for message in messages:
        message.header.frame_id = message.header.frame_id or common
    return [framed_pose_from_ros(message, frame) for message in messages]


def framed_point_from_ros(message: Any, frame: str = WORLD_FRAME) -> Vector:
    """Return the upright state, shape (6,), at a PointStamped; otherwise as for a pose."""
    _check_frame(message, frame)
    return upright_state(message.point.x, message.point.y, 0.0)


def trajectory_message(hold: FirstOrderHold, epoch: int = 0) -> bytes:
    """Return a first-order hold as the JointTrajectory of velocities alone at its knots.

    It is stamped with the time of the first one. A controller that interpolates the speeds
    linearly, as ros2_controllers' joint trajectory controller does with velocities alone, moves
    the rotors exactly as planned.
    """
    start = stamp_of(hold.start, epoch)
    # As `stamp_of`, for all knots.
    after = np.rint(hold.times * NANOSECONDS).astype(np.int64) - (start - epoch)
    points = np.zeros(hold.times.size, _POINT)
    points["before"] = _VELOCITIES_ONLY
    points["speeds"] = hold.speeds
    points["seconds"], points["nanoseconds"] = np.divmod(after, NANOSECONDS)
    count = _LENGTH.pack(hold.times.size)
    return b"".join((clock_message(start), _JOINTS, count, points.tobytes()))


def hold_and_stamp(raw: bytes, now: int, epoch: int = 0) -> tuple[FirstOrderHold, int]:
    """Return hold and stamp [ns] of a serialised JointTrajectory; see `hold_from_trajectory`."""
    points = _points(raw)
    if points is None:
        read = message_object(raw, JointTrajectory)
        return hold_from_trajectory(read, now, epoch), stamp_from_ros(read.header.stamp)
    stamp = _stamp(raw) or 0
    after = points["seconds"].astype(np.int64) * NANOSECONDS + points["nanoseconds"]
    times = (after + ((stamp or now) - epoch)) / NANOSECONDS
    return FirstOrderHold(times, points["speeds"]), stamp


def hold_from_trajectory(message: Any, now: int, epoch: int = 0) -> FirstOrderHold:
    """Return the first-order hold of a trajectory; rotors are matched by name, in any order.

    Points need velocities [rad/s]; positions and accelerations are ignored. `now` is the start
    [ns] of a trajectory with stamp 0, which means "now".
    """
    order = _order_of_rotors(message.joint_names)
    given = [len(point.velocities) for point in message.points]
    if not given or any(number != len(order) for number in given):
        raise InvalidInputError(
            "velocities of the points", given, f"one point or more with {len(order)} each"
        )
    start = stamp_from_ros(message.header.stamp) or now
    times = [
        seconds(start + stamp_from_ros(point.time_from_start), epoch) for point in message.points
    ]
    speeds = [[point.velocities[i] for i in order] for point in message.points]
    return FirstOrderHold(np.array(times), np.array(speeds))


def speeds_message(speeds: Vector) -> bytes:
    """Return rotor speeds [rad/s], shape (2,), as a Float64MultiArray."""
    return _SPEEDS_HEAD + _SPEEDS.pack(*speeds.tolist())


def speeds_of_message(raw: bytes) -> Vector:
    """Return the numbers of a serialised Float64MultiArray, shape (K,)."""
    at = len(_SPEEDS_HEAD)
    if raw.startswith(_SPEEDS_HEAD) and len(raw) >= at + _SPEEDS.size:
        return np.array(_SPEEDS.unpack_from(raw, at))
    return np.array(message_object(raw, Float64MultiArray).data, dtype=float)


def joint_states_message(angles: Vector, speeds: Vector, torques: Vector, stamp: int) -> bytes:
    """Return rotor angles [rad], speeds [rad/s] and motor torques [N m], each of shape (2,)."""
    both = len(JOINT_NAMES)
    values = _STATES.pack(both, *angles.tolist(), both, *speeds.tolist(), both, *torques.tolist())
    return clock_message(stamp) + _JOINTS + values


def joint_states_from_ros(message: Any) -> tuple[Vector, Vector, Vector]:
    """Return rotor angles [rad], speeds [rad/s] and torques [N m], rotor 1 first."""
    order = _order_of_rotors(message.name)
    parts = (message.position, message.velocity, message.effort)
    angles, speeds, torques = (np.array(part, dtype=float)[order] for part in parts)
    return angles, speeds, torques


def rotor_speeds_and_stamp(raw: bytes) -> tuple[Vector | None, int]:
    """Return rotor speeds [rad/s], shape (2,), and stamp [ns] of a serialised JointState.

    The joints may be more, in any order; the speeds are None if one is missing or not finite.
    """
    message = message_object(raw, JointState)
    names, given, stamp = list(message.name), message.velocity, message.header.stamp
    if len(given) != len(names) or any(name not in names for name in JOINT_NAMES):
        return None, stamp_from_ros(stamp)
    speeds = np.array([given[names.index(name)] for name in JOINT_NAMES])
    return speeds if np.isfinite(speeds).all() else None, stamp_from_ros(stamp)


def odometry_to_ros(
    state: Vector, velocity: Vector, body_rate: Vector, stamp: int, shell_radius: float,
    body_frame: str = BODY_FRAME, frame: str = WORLD_FRAME,
) -> Odometry:
    """Return pose and twist, the twist in the body frame as Odometry demands.

    `velocity` is that of the centre [m/s; world frame], shape (3,), `body_rate` the angular
    velocity [rad/s; body frame], shape (3,); for the others see `pose_message`.
    """
    message = Odometry()
    message.header.stamp = stamp_to_ros(stamp)
    message.header.frame_id = frame
    message.child_frame_id = body_frame
    _fill_pose(message.pose.pose, state, shell_radius)
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, linear.z = rotation.to_body(state[QUATERNION], velocity)
    angular.x, angular.y, angular.z = (float(value) for value in body_rate)
    return message


def transform_from_pose(
    message: PoseStamped, body_frame: str = BODY_FRAME
) -> TransformStamped:
    """Return the transform from the body to the frame of its pose."""
    transform = TransformStamped(header=message.header, child_frame_id=body_frame)
    place, shift = message.pose.position, transform.transform.translation
    shift.x, shift.y, shift.z = place.x, place.y, place.z
    transform.transform.rotation = message.pose.orientation
    return transform


def path_to_ros(
    times: Sequence[float] | Vector, states: Vector, shell_radius: float, epoch: int = 0,
    frame: str = WORLD_FRAME,
) -> Path:
    """Return predicted states, shape (K, 6), at control times [s] as a path of stamped poses."""
    message = Path()
    message.header.frame_id = frame
    message.poses = [
        pose_to_ros(state, stamp_of(float(time), epoch), shell_radius, frame)
        for time, state in zip(times, states, strict=False)
    ]
    if message.poses:
        message.header.stamp = message.poses[0].header.stamp
    return message


def message_object(raw: bytes, kind: Any) -> Any:
    """Return the object of a serialised message."""
    try:
        return deserialize_message(raw, kind)
    except Exception:  # the middleware's own types of error are private to it
        raise InvalidInputError(kind.__name__, raw, "a message of this type") from None


def _stamp(raw: bytes) -> int | None:
    """Return the stamp [ns] that a message in plain CDR begins with; None if it is no such one."""
    if not (raw.startswith(_PLAIN) and len(raw) >= _BODY):
        return None
    seconds, nanoseconds = _STAMP.unpack_from(raw, _BEGIN)
    return int(seconds * NANOSECONDS + nanoseconds)


def _points(raw: bytes) -> Any:
    """Return the points of a trajectory of the usual layout, None where it has another one.

    That is no frame, the joints in their order, and velocities only.
    """
    if not (raw.startswith(_PLAIN) and raw.startswith(_JOINTS, _BODY) and len(raw) >= _POINTS):
        return None
    (count,) = _LENGTH.unpack_from(raw, _POINTS - _LENGTH.size)
    if not 0 < count <= (len(raw) - _POINTS) // _POINT.itemsize:
        return None
    points = np.frombuffer(raw, _POINT, count, _POINTS)
    usual = (points["before"] == _VELOCITIES_ONLY).all() and not points["after"].any()
    return points if usual else None


def _pose_object(raw: bytes) -> Any:
    try:
        return message_object(raw, PoseStamped)
    except InvalidInputError as error:
        raise InvalidStateError(error.name, error.given, error.expected) from None


def _check_frame(message: Any, frame: str) -> None:
    given = message.header.frame_id
    if given not in ("", frame):
        raise InvalidStateError("frame", given, f"'{frame}' (world_frame) or none")


def _fill_pose(pose: Any, state: Vector, height: float) -> None:
    place, turn = pose.position, pose.orientation
    place.x, place.y = state[POSITION].tolist()
    place.z = height
    turn.w, turn.x, turn.y, turn.z = state[QUATERNION].tolist()


def _order_of_rotors(names: Sequence[str]) -> list[int]:
    if sorted(names) != sorted(JOINT_NAMES):
        raise InvalidInputError(
            "rotor names", list(names), f"{list(JOINT_NAMES)} in any order"
        )
    return [list(names).index(name) for name in JOINT_NAMES]
