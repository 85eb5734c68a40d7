# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages in their serialised form (CDR) as arrays and stamps, without ROS.

Stamps are whole nanoseconds, so that they compare exactly; control times are seconds since
`epoch`, a stamp [ns] that is 0 in simulated time. wxyz becomes xyzw here, in `cdr_messages` and in
`messages` only.

Nodes read and write what passes at up to 2000 Hz in this form, as rclpy makes message objects
field by field: with objects a pose or a trajectory of ten knots takes ten times as long.
Recordings are read in the same way. `read` reads a message of any machine as the record of its
type, with its fields as they are, unchecked; `cdr_messages` makes messages.

What cannot be read raises an `InvalidInputError`, a pose that cannot be used an
`InvalidStateError`.
"""

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.error_state import error_covariance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector, make_state
from sphere_nmpc.quantities import NANOSECONDS

JOINT_NAMES = ("rotor_1_joint", "rotor_2_joint")
"""Names of the rotors about body x and body y."""
LARGEST_JOINTS = 100_000, "some thousand joints"
"""Size of the largest message of joint states that is read [bytes], and what it is enough for."""
WORLD_FRAME = "world"
BODY_FRAME = "base_link"

PLAIN = b"\x00\x01\x00\x00"
"""Encapsulation: plain CDR with the least significant byte first."""
_NOT_MEASURED = -1.0
"""First element of a covariance of `Imu` whose quantity is not measured."""
_ORDERS = {PLAIN[:2]: "<", b"\x00\x00": ">"}
BEGIN = len(PLAIN)
"""Where the message begins; its numbers are aligned to their size from here."""
STAMP, LENGTH = struct.Struct("<iI"), struct.Struct("<I")


class Clock(NamedTuple):
    """Time [ns]."""

    stamp: int


class Pose(NamedTuple):
    """Stamped pose: x, y, z [m] and the quaternion xyzw."""

    stamp: int
    frame: str
    numbers: tuple[float, ...]

    @property
    def state(self) -> tuple[float, ...]:
        """Numbers of the state x, y [m] and quaternion wxyz, unchecked."""
        x, y, _, qx, qy, qz, qw = self.numbers
        return x, y, qw, qx, qy, qz

    def in_frame(self, frame: str) -> Vector:
        """Return the state, shape (6,); see `pose_in_frame`."""
        return pose_in_frame(self.numbers, self.frame, frame)


class Text(NamedTuple):
    """Text alone."""

    text: str


class UncertainPose(NamedTuple):
    """Stamped pose with the covariance of x, y, z [m] and turns about the fixed axes [rad].

    The 43 numbers are those of `Pose`, and the covariance row by row.
    """

    stamp: int
    frame: str
    numbers: tuple[float, ...]

    @property
    def state(self) -> tuple[float, ...]:
        """State as that of `Pose`."""
        return Pose(self.stamp, self.frame, self.numbers[:7]).state

    def in_frame(self, frame: str) -> tuple[Vector, Vector | None]:
        """Return state, shape (6,), and covariance of its error; see `pose_in_frame`.

        The covariance is that of `error_covariance`.
        """
        pose = pose_in_frame(self.numbers[:7], self.frame, frame)
        return pose, error_covariance(pose, np.array(self.numbers[7:]).reshape(6, 6))


class Imu(NamedTuple):
    """Orientation, angular velocity [rad/s] and specific force [m/s^2], each with its covariance.

    The 37 numbers are the quaternion xyzw, and of each of the three the covariance row by row.
    """

    stamp: int
    frame: str
    numbers: tuple[float, ...]

    @property
    def rate(self) -> tuple[float, ...]:
        """Angular velocity [rad/s; in the frame]."""
        return self.numbers[13:16]

    @property
    def force(self) -> tuple[float, ...]:
        """Specific force [m/s^2; in the frame]."""
        return self.numbers[25:28]

    def check_measured(self) -> None:
        """Raise `InvalidInputError` if it says that it does not measure one of the two."""
        for name, first in (("angular_velocity", 16), ("linear_acceleration", 28)):
            if self.numbers[first] == _NOT_MEASURED:
                raise InvalidInputError(
                    f"{name}_covariance", _NOT_MEASURED, "one that does not begin with -1, which "
                    f"stands for an IMU that does not measure the {name}",
                )


class Joints(NamedTuple):
    """Angles [rad], speeds [rad/s] and torques [N m] of joints."""

    stamp: int
    frame: str
    names: list[str]
    angles: Vector
    speeds: Vector
    torques: Vector

    def of_rotors(self) -> Vector | None:
        """Return angles, speeds and torques of the rotors, shape (3, 2); None if one is missing.

        They are nan where the message has fewer numbers than names.
        """
        order = [self.names.index(name) for name in JOINT_NAMES if name in self.names]
        if len(order) < len(JOINT_NAMES):
            return None
        return np.array([
            [values[i] if i < len(values) else np.nan for i in order]
            for values in (self.angles, self.speeds, self.torques)
        ])


class Trajectory(NamedTuple):
    """Points of a trajectory: positions, velocities, accelerations, efforts, time after start."""

    stamp: int
    frame: str
    names: list[str]
    points: list[tuple[Vector, Vector, Vector, Vector, int]]

    def knots(self) -> tuple[NDArray[np.int64], Vector]:
        """Return times after the start [ns], shape (K,), and rotor speeds [rad/s], shape (K, 2).

        Rotors are matched by name, in any order. Points need velocities; positions and
        accelerations are ignored.
        """
        if sorted(self.names) != sorted(JOINT_NAMES):
            raise InvalidInputError(
                "rotor names", self.names, f"{list(JOINT_NAMES)} in any order"
            )
        order = [self.names.index(name) for name in JOINT_NAMES]
        given = [len(point[1]) for point in self.points]
        if not given or any(number != len(order) for number in given):
            raise InvalidInputError(
                "velocities of the points", given, f"one point or more with {len(order)} each"
            )
        after: NDArray[np.int64] = np.array([point[4] for point in self.points], dtype=np.int64)
        speeds: Vector = np.array([point[1] for point in self.points], dtype=float)
        return after, speeds[:, order]


class Status(NamedTuple):
    """Status with its key-value pairs."""

    level: tuple[int]
    name: str
    message: str
    hardware: str
    pairs: list[tuple[str, str]]

    @property
    def values(self) -> dict[str, str]:
        """Values by their keys."""
        return dict(self.pairs)


class Diagnostics(NamedTuple):
    """Statuses of any nodes, as their fields."""

    stamp: int
    frame: str
    fields: list[Any]

    @property
    def statuses(self) -> list[Status]:
        """The statuses."""
        return [Status(*fields) for fields in self.fields]


class Vector3(NamedTuple):
    """Stamped vector."""

    stamp: int
    frame: str
    vector: tuple[float, ...]


class OccupancyGrid(NamedTuple):
    """Map with side of its cells [m], width, height, pose of its corner, and values row by row."""

    stamp: int
    frame: str
    loaded: int
    resolution: tuple[float]
    size: tuple[int, int]
    origin: tuple[float, ...]
    cells: Any


class Numbers(NamedTuple):
    """Numbers with a description of their dimensions and an offset."""

    dimensions: list[tuple[str, tuple[int, int]]]
    offset: tuple[int]
    numbers: Vector


TYPES: dict[Any, str] = {
    Pose: "geometry_msgs/msg/PoseStamped",
    UncertainPose: "geometry_msgs/msg/PoseWithCovarianceStamped",
    Imu: "sensor_msgs/msg/Imu",
    Numbers: "std_msgs/msg/Float64MultiArray",
    Joints: "sensor_msgs/msg/JointState",
    Trajectory: "trajectory_msgs/msg/JointTrajectory",
    Status: "diagnostic_msgs/msg/DiagnosticStatus",
    Diagnostics: "diagnostic_msgs/msg/DiagnosticArray",
    Vector3: "geometry_msgs/msg/Vector3Stamped",
    OccupancyGrid: "nav_msgs/msg/OccupancyGrid",
}
"""Types of messages by the records of those that are read of a recording."""
RECORDS = {msgtype: record for record, msgtype in TYPES.items()}
"""Records by types of messages."""
_TEXT, _TIME, _ARRAY, _LIST = "text", "time", "array", "list"
_HEADS = {_TEXT: "I", _TIME: "iI", _ARRAY: "I", _LIST: "I"}
"""Numbers that fields of these kinds begin with."""
_Field: TypeAlias = tuple[str, int, struct.Struct, Any]
"""How a field is read: its kind, the alignment [bytes] and the reader of the numbers that it
begins with, and the type of the numbers of an array or the fields of a list's record."""
_NO_NUMBERS: Vector = np.empty(0)
_HEADER = _TIME, _TEXT
_STATUS = ("B", _TEXT, _TEXT, _TEXT, [(_TEXT, _TEXT)])
_LAYOUTS: dict[Any, tuple[Any, ...]] = {
    Clock: (_TIME,),
    Text: (_TEXT,),
    Pose: (*_HEADER, "7d"),
    UncertainPose: (*_HEADER, "43d"),
    Imu: (*_HEADER, "37d"),
    Joints: (*_HEADER, [_TEXT], ["d"], ["d"], ["d"]),
    Trajectory: (*_HEADER, [_TEXT], [(["d"], ["d"], ["d"], ["d"], _TIME)]),
    Status: _STATUS,
    Diagnostics: (*_HEADER, [_STATUS]),
    Vector3: (*_HEADER, "3d"),
    OccupancyGrid: (*_HEADER, _TIME, "f", "2I", "7d", ["b"]),
    Numbers: ([(_TEXT, "2I")], "I", ["d"]),
}
"""Kinds of the fields of records, in the order in which a message has them: a string; a time, as
whole nanoseconds; numbers in letters of `struct`, read as a tuple. A list has any number of its
kind; a tuple is a record of kinds."""


def _compiled(order: str, kinds: Sequence[Any]) -> list[_Field]:
    """Return how to read fields of these kinds, of numbers in this order of bytes."""
    layout: list[_Field] = []
    for given in kinds:
        kind: Any = given
        item: Any = None
        if isinstance(given, list):
            (of,) = given
            if of is not _TEXT and isinstance(of, str):
                kind, item = _ARRAY, np.dtype(order + of)
            else:
                kind, item = _LIST, _compiled(order, of if isinstance(of, tuple) else (of,))
        head = struct.Struct(order + _HEADS.get(kind, kind))
        layout.append((kind, struct.calcsize("<" + head.format[-1]), head, item))
    return layout


_COMPILED = {
    first: {record: _compiled(order, kinds) for record, kinds in _LAYOUTS.items()}
    for first, order in _ORDERS.items()
}
"""How to read messages by the first bytes of their encapsulation and their record."""
_Record = TypeVar("_Record")


def fields(raw: bytes, record: type) -> tuple[Any, ...]:
    """Return the fields of a serialised message in the order of the record of its type."""
    try:
        return _fields(raw, BEGIN, _COMPILED[raw[:2]][record])[0]
    except (KeyError, ValueError, struct.error):
        raise InvalidInputError(record.__name__, raw, "a message of this type") from None


def read(raw: bytes, record: type[_Record]) -> _Record:
    """Return a serialised message as a record of its type."""
    return record(*fields(raw, record))


def seconds(stamp: int, epoch: int = 0) -> float:
    """Return a stamp [ns] as control time [s] since `epoch` [ns]."""
    return (stamp - epoch) / NANOSECONDS


def stamp_of(time: float, epoch: int = 0) -> int:
    """Return the stamp [ns] of a control time [s] since `epoch` [ns]."""
    return epoch + round(time * NANOSECONDS)


def clock_stamp(raw: bytes) -> int:
    """Return the stamp [ns] of a Clock message, of 0 or more, as a ROS clock has it."""
    stamp = read(raw, Clock).stamp
    if stamp < 0:
        raise InvalidInputError("clock", stamp / NANOSECONDS, "0 or more [s]")
    return stamp


def pose_in_frame(numbers: tuple[float, ...], given: str, frame: str) -> Vector:
    """Return the state, shape (6,), of numbers as in `Pose`, given in the frame or without one."""
    if given not in ("", frame):
        raise InvalidStateError("frame", given, f"'{frame}' (world_frame) or none")
    x, y, _, qx, qy, qz, qw = numbers
    return make_state((x, y), (qw, qx, qy, qz))


def hold_and_stamp(raw: bytes, now: int, epoch: int = 0) -> tuple[FirstOrderHold, int]:
    """Return hold and stamp [ns] of a serialised JointTrajectory; see `Trajectory.knots`.

    `now` is the start [ns] of a trajectory with stamp 0, which means "now".
    """
    trajectory = read(raw, Trajectory)
    after, speeds = trajectory.knots()
    times = (after + ((trajectory.stamp or now) - epoch)) / NANOSECONDS
    return FirstOrderHold(times, speeds), trajectory.stamp


def rotor_speeds_and_stamp(raw: bytes) -> tuple[Vector | None, int]:
    """Return rotor speeds [rad/s], shape (2,), and stamp [ns] of a serialised JointState.

    The joints may be more, in any order; the speeds are None if one is missing or not finite.
    """
    joints = read(raw, Joints)
    found = joints.of_rotors()
    return None if found is None or not np.isfinite(found[1]).all() else found[1], joints.stamp


def _fields(raw: bytes, at: int, layout: list[_Field]) -> tuple[tuple[Any, ...], int]:
    """Return fields of a message from a place on, and the place behind them."""
    values: list[Any] = []
    for kind, size, head, item in layout:
        at += (BEGIN - at) % size
        numbers = head.unpack_from(raw, at)
        at += head.size
        value: Any = numbers
        if kind is _TIME:
            value = numbers[0] * NANOSECONDS + numbers[1]
        elif kind is _TEXT:
            text = raw[at : at + numbers[0]]
            if len(text) < numbers[0]:
                raise ValueError(numbers)
            value = text.removesuffix(b"\x00").decode(errors="replace")
            at += len(text)
        elif kind is _ARRAY:
            value = _NO_NUMBERS
            if numbers[0]:
                at += (BEGIN - at) % item.itemsize
                value = np.frombuffer(raw, item, numbers[0], at)
                at += value.nbytes
        elif kind is _LIST:
            value = []
            for _ in range(numbers[0]):
                record, at = _fields(raw, at, item)
                value.append(record if len(record) > 1 else record[0])
        values.append(value)
    return tuple(values), at
