# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages in their serialised form (CDR) of arrays and stamps, without ROS; see `cdr`."""

import struct
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector, upright_state
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.cdr import BEGIN, JOINT_NAMES, LENGTH, PLAIN, STAMP, WORLD_FRAME, stamp_of


def clock_message(stamp: int) -> bytes:
    """Return the Clock message of a stamp [ns]."""
    return PLAIN + STAMP.pack(*divmod(stamp, NANOSECONDS))


def pose_message(
    state: Vector, stamp: int, shell_radius: float, frame: str = WORLD_FRAME
) -> bytes:
    """Return a state, shape (6,), as the PoseStamped of a sphere resting on the plane z = 0.

    `stamp` is its time [ns], `shell_radius` the height of the centre [m].
    """
    x, y, qw, qx, qy, qz = state.tolist()
    return _stamped(stamp, frame, x, y, shell_radius, qx, qy, qz, qw)


def transforms_message(
    stamp: int, transforms: Sequence[tuple[str, str, Sequence[float]]]
) -> bytes:
    """Return the TFMessage of frames in their parents, at a stamp [ns].

    Each has the frames of parent and child, x, y, z [m] and the quaternion xyzw.
    """
    message, time = PLAIN + LENGTH.pack(len(transforms)), STAMP.pack(*divmod(stamp, NANOSECONDS))
    for parent, child, numbers in transforms:
        message = _with_numbers(message + time + _text(parent, child), *numbers)
    return message


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
    count = LENGTH.pack(hold.times.size)
    return b"".join((clock_message(start), _JOINTS, count, points.tobytes()))


def speeds_message(speeds: Vector) -> bytes:
    """Return rotor speeds [rad/s], shape (2,), as a Float64MultiArray."""
    return PLAIN + struct.pack("<3I4x2d", 0, 0, len(JOINT_NAMES), *speeds.tolist())


def joint_states_message(angles: Vector, speeds: Vector, torques: Vector, stamp: int) -> bytes:
    """Return rotor angles [rad], speeds [rad/s] and motor torques [N m], each of shape (2,)."""
    both = len(JOINT_NAMES)
    values = _STATES.pack(both, *angles.tolist(), both, *speeds.tolist(), both, *torques.tolist())
    return clock_message(stamp) + _JOINTS + values


def floor_message(grid: Grid | None, stamp: int, frame: str) -> bytes:
    """Return an OccupancyGrid of values 0 and 100 with a stamp [ns]; one of no cells for None."""
    grid = grid or Grid(np.empty((0, 0), bool), 0.0, (0.0, 0.0, 0.0))
    x, y, qw, qx, qy, qz = upright_state(*grid.origin).tolist()
    (height, width), time = grid.occupied.shape, divmod(stamp, NANOSECONDS)
    head = PLAIN + STAMP.pack(*time) + _text(frame)
    head += struct.pack("<iIfII", *time, grid.resolution, width, height)
    head += bytes((BEGIN - len(head)) % 8)
    head += struct.pack("<7dI", x, y, 0.0, qx, qy, qz, qw, grid.occupied.size)
    return head + (grid.occupied.view(np.int8) * np.int8(100)).tobytes()


def _stamped(stamp: int, frame: str, *numbers: float) -> bytes:
    """Return the message of a header and numbers in double precision."""
    return _with_numbers(clock_message(stamp) + _text(frame), *numbers)


def _with_numbers(head: bytes, *numbers: float) -> bytes:
    """Return the head of a message and aligned numbers in double precision."""
    return head + bytes((BEGIN - len(head)) % 8) + struct.pack(f"<{len(numbers)}d", *numbers)


@lru_cache
def _text(*words: str) -> bytes:
    """Return strings as CDR has them: length, characters, a zero byte, and padding to four."""
    parts = [word.encode() + b"\x00" for word in words]
    return b"".join(LENGTH.pack(len(part)) + part + bytes(-len(part) % 4) for part in parts)


_JOINTS = _text("") + LENGTH.pack(len(JOINT_NAMES)) + _text(*JOINT_NAMES)
"""Layout from the stamp to the values: no frame, and the names of the joints."""
_POINT = np.dtype([
    ("positions", "<u8"), ("angles", "<f8", (2,)), ("velocities", "<u8"), ("speeds", "<f8", (2,)),
    ("after", "<u8"), ("seconds", "<i4"), ("nanoseconds", "<u4"),
])
"""Point of a trajectory: number of positions and, aligned, the positions; the same of velocities;
numbers of accelerations and efforts, and the time."""
_STATES = struct.Struct("<I2dI4x2dI4x2d")
