# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages in their serialised form (CDR), from and to arrays and stamps, without ROS.

Stamps are whole nanoseconds, so that they compare exactly; control times are seconds since
`epoch`, a stamp [ns] that is 0 in simulated time. wxyz becomes xyzw here and in `messages` only.

Nodes read and write what passes at up to 2000 Hz in this form, as rclpy makes message objects
field by field: with objects a pose or a trajectory of ten knots takes ten times as long to write.
Recordings are read in the same way. `read` reads a message of any machine as the record of its
type, with its fields as they are, unchecked.

What cannot be read raises an `InvalidInputError`, a pose that cannot be used an
`InvalidStateError`.
"""

import struct
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.error_state import error_covariance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector, make_state, upright_state
from sphere_nmpc.quantity import NANOSECONDS

JOINT_NAMES = ("rotor_1_joint", "rotor_2_joint")
"""Names of the rotors about body x and body y."""
LARGEST_JOINTS = 100_000, "some thousand joints"
"""Size of the largest message of joint states that is read [bytes], and what it is enough for."""
WORLD_FRAME = "world"
BODY_FRAME = "base_link"

_PLAIN = b"\x00\x01\x00\x00"
"""Encapsulation: plain CDR with the least significant byte first."""
_NOT_MEASURED = -1.0
"""First element of a covariance of `Imu` whose quantity is not measured."""
_ORDERS = {_PLAIN[:2]: "<", b"\x00\x00": ">"}
_BEGIN = len(_PLAIN)
"""Where the message begins; its numbers are aligned to their size from here."""
_STAMP, _LENGTH = struct.Struct("<iI"), struct.Struct("<I")


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
        return _fields(raw, _BEGIN, _COMPILED[raw[:2]][record])[0]
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


def clock_message(stamp: int) -> bytes:
    """Return the Clock message of a stamp [ns]."""
    return _PLAIN + _STAMP.pack(*divmod(stamp, NANOSECONDS))


def clock_stamp(raw: bytes) -> int:
    """Return the stamp [ns] of a Clock message, of 0 or more, as a ROS clock has it."""
    stamp = read(raw, Clock).stamp
    if stamp < 0:
        raise InvalidInputError("clock", stamp / NANOSECONDS, "0 or more [s]")
    return stamp


def pose_message(
    state: Vector, stamp: int, shell_radius: float, frame: str = WORLD_FRAME
) -> bytes:
    """Return a state, shape (6,), as the PoseStamped of a sphere resting on the plane z = 0.

    `stamp` is its time [ns], `shell_radius` the height of the centre [m].
    """
    x, y, qw, qx, qy, qz = state.tolist()
    return _stamped(stamp, frame, x, y, shell_radius, qx, qy, qz, qw)


def imu_message(
    rate: Vector, force: Vector, deviations: Vector, stamp: int, frame: str
) -> bytes:
    """Return an Imu message without orientation, whose covariance then begins with -1.

    `rate` is the angular velocity [rad/s], `force` the specific force [m/s^2], both of shape (3,)
    in the frame, `deviations` those of their white noise about each axis, shape (2,).
    """
    turning, pulling = ((square, 0.0, 0.0, 0.0) * 2 + (square,) for square in deviations**2)
    return _stamped(
        stamp, frame, 0.0, 0.0, 0.0, 1.0, -1.0, *(0.0,) * 8, *rate.tolist(), *turning,
        *force.tolist(), *pulling,
    )


def pose_of_message(raw: bytes, frame: str = WORLD_FRAME) -> Vector:
    """Return the state, shape (6,), of a serialised PoseStamped; see `pose_in_frame`."""
    _, given, numbers = fields(raw, Pose)
    return pose_in_frame(numbers, given, frame)


def pose_in_frame(numbers: tuple[float, ...], given: str, frame: str) -> Vector:
    """Return the state, shape (6,), of numbers as in `Pose`, given in the frame or without one."""
    if given not in ("", frame):
        raise InvalidStateError("frame", given, f"'{frame}' (world_frame) or none")
    x, y, _, qx, qy, qz, qw = numbers
    return make_state((x, y), (qw, qx, qy, qz))


def trajectory_message(hold: FirstOrderHold, angles: Vector, epoch: int = 0) -> bytes:
    """Return a first-order hold as a JointTrajectory of positions and velocities at its knots.

    It is stamped with the time of the first one, at which the rotors have `angles` [rad], shape
    (2,). The positions are the integral of the speeds, so that the cubics of ros2_controllers'
    joint trajectory controller are parabolas and the rotors move exactly as planned. Without
    positions it fails: it looks for them at the first point, to unwrap continuous joints, and at
    the point before a trajectory is first sampled.
    """
    start = stamp_of(hold.start, epoch)
    # As `stamp_of`, for all knots.
    after = np.rint(hold.times * NANOSECONDS).astype(np.int64) - (start - epoch)
    points = np.zeros(hold.times.size, _POINT)
    points["positions"] = points["velocities"] = len(JOINT_NAMES)
    speeds = points["speeds"] = hold.speeds
    reached = points["angles"]
    reached[0] = angles
    reached[1:] = 0.5 * (hold.times[1:] - hold.times[:-1])[:, None] * (speeds[1:] + speeds[:-1])
    reached.cumsum(axis=0, out=reached)
    points["seconds"], points["nanoseconds"] = np.divmod(after, NANOSECONDS)
    count = _LENGTH.pack(hold.times.size)
    return b"".join((clock_message(start), _JOINTS, count, points.tobytes()))


def hold_and_stamp(raw: bytes, now: int, epoch: int = 0) -> tuple[FirstOrderHold, int]:
    """Return hold and stamp [ns] of a serialised JointTrajectory; see `Trajectory.knots`.

    `now` is the start [ns] of a trajectory with stamp 0, which means "now".
    """
    trajectory = read(raw, Trajectory)
    after, speeds = trajectory.knots()
    times = (after + ((trajectory.stamp or now) - epoch)) / NANOSECONDS
    return FirstOrderHold(times, speeds), trajectory.stamp


def speeds_message(speeds: Vector) -> bytes:
    """Return rotor speeds [rad/s], shape (2,), as a Float64MultiArray."""
    return _PLAIN + struct.pack("<3I4x2d", 0, 0, len(JOINT_NAMES), *speeds.tolist())


def speeds_of_message(raw: bytes) -> Vector:
    """Return the numbers of a serialised Float64MultiArray, shape (K,)."""
    return read(raw, Numbers).numbers


def joint_states_message(angles: Vector, speeds: Vector, torques: Vector, stamp: int) -> bytes:
    """Return rotor angles [rad], speeds [rad/s] and motor torques [N m], each of shape (2,)."""
    both = len(JOINT_NAMES)
    values = _STATES.pack(both, *angles.tolist(), both, *speeds.tolist(), both, *torques.tolist())
    return clock_message(stamp) + _JOINTS + values


def rotor_speeds_and_stamp(raw: bytes) -> tuple[Vector | None, int]:
    """Return rotor speeds [rad/s], shape (2,), and stamp [ns] of a serialised JointState.

    The joints may be more, in any order; the speeds are None if one is missing or not finite.
    """
    joints = read(raw, Joints)
    found = joints.of_rotors()
    return None if found is None or not np.isfinite(found[1]).all() else found[1], joints.stamp


def floor_message(grid: Grid | None, stamp: int, frame: str) -> bytes:
    """Return an OccupancyGrid of values 0 and 100 with a stamp [ns]; one of no cells for None."""
    grid = grid or Grid(np.empty((0, 0), bool), 0.0, (0.0, 0.0, 0.0))
    x, y, qw, qx, qy, qz = upright_state(*grid.origin).tolist()
    (height, width), time = grid.occupied.shape, divmod(stamp, NANOSECONDS)
    head = _PLAIN + _STAMP.pack(*time) + _text(frame)
    head += struct.pack("<iIfII", *time, grid.resolution, width, height)
    head += bytes((_BEGIN - len(head)) % 8)
    head += struct.pack("<7dI", x, y, 0.0, qx, qy, qz, qw, grid.occupied.size)
    return head + (grid.occupied.view(np.int8) * np.int8(100)).tobytes()


def _fields(raw: bytes, at: int, layout: list[_Field]) -> tuple[tuple[Any, ...], int]:
    """Return fields of a message from a place on, and the place behind them."""
    values: list[Any] = []
    for kind, size, head, item in layout:
        at += (_BEGIN - at) % size
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
                at += (_BEGIN - at) % item.itemsize
                value = np.frombuffer(raw, item, numbers[0], at)
                at += value.nbytes
        elif kind is _LIST:
            value = []
            for _ in range(numbers[0]):
                record, at = _fields(raw, at, item)
                value.append(record if len(record) > 1 else record[0])
        values.append(value)
    return tuple(values), at


def _stamped(stamp: int, frame: str, *numbers: float) -> bytes:
    """Return the message of a header and numbers in double precision."""
    head = clock_message(stamp) + _text(frame)
    return head + bytes((_BEGIN - len(head)) % 8) + struct.pack(f"<{len(numbers)}d", *numbers)


@cache
def _text(*words: str) -> bytes:
    """Return strings as CDR has them: length, characters, a zero byte, and padding to four."""
    parts = [word.encode() + b"\x00" for word in words]
    return b"".join(_LENGTH.pack(len(part)) + part + bytes(-len(part) % 4) for part in parts)


_JOINTS = _text("") + _LENGTH.pack(len(JOINT_NAMES)) + _text(*JOINT_NAMES)
"""Layout from the stamp to the values: no frame, and the names of the joints."""
_POINT = np.dtype([
    ("positions", "<u8"), ("angles", "<f8", (2,)), ("velocities", "<u8"), ("speeds", "<f8", (2,)),
    ("after", "<u8"), ("seconds", "<i4"), ("nanoseconds", "<u4"),
])
"""Point of a trajectory: number of positions and, aligned, the positions; the same of velocities;
numbers of accelerations and efforts, and the time."""
_STATES = struct.Struct("<I2dI4x2dI4x2d")
