# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between arrays and ROS messages; wxyz becomes xyzw here and in `serialised` only.

Stamps are whole nanoseconds on this side, so that they compare exactly; control times are seconds
since `epoch`, a stamp that is 0 in simulated time. Messages are read by attribute, so that those
decoded by a bag reader are accepted as well as those from a subscription.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from sphere_nmpc.errors import InvalidInputError, InvalidParameterError, InvalidStateError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state
from sphere_nmpc.quantity import NANOSECONDS, quantity, validate

JOINT_NAMES = ("rotor_1_joint", "rotor_2_joint")
"""Names of the rotors about body x and body y."""
WORLD_FRAME = "world"
BODY_FRAME = "base_link"


@dataclass(frozen=True)
class FrameSettings:
    """Frame that poses and goals are given in.

    Raises
    ------
    InvalidParameterError
        If it is empty or begins with a slash, which tf2 refuses.
    """

    world_frame: str = quantity(
        WORLD_FRAME, "-",
        "Frame of poses, goals and plans; those in another frame are refused, those without one "
        "are taken to be in it",
    )

    def __post_init__(self) -> None:
        validate(self)
        if not self.world_frame or self.world_frame.startswith("/"):
            raise InvalidParameterError(
                "world_frame", self.world_frame, "a name that begins without /"
            )


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


def pose_to_ros(
    state: Vector, stamp: int, shell_radius: float, frame: str = WORLD_FRAME
) -> PoseStamped:
    """Return a state, shape (6,), as the pose of a sphere resting on the plane z = 0.

    Parameters
    ----------
    state : ndarray, shape (6,)
        [x, y, qw, qx, qy, qz] [m; world frame], body to world.
    stamp : int
        Time of the state [ns].
    shell_radius : float
        Height of the centre [m].
    frame : str, optional
        Frame of the pose.
    """
    message = PoseStamped()
    message.header.stamp = stamp_to_ros(stamp)
    message.header.frame_id = frame
    _fill_pose(message.pose, state, shell_radius)
    return message


def pose_from_ros(message: Any) -> Vector:
    """Return the state, shape (6,), of a PoseStamped; its height and frame are ignored.

    Raises
    ------
    InvalidStateError
        If a number is not finite or the quaternion is not of unit norm.
    """
    place, turn = message.pose.position, message.pose.orientation
    return make_state((place.x, place.y), (turn.w, turn.x, turn.y, turn.z))


def framed_pose_from_ros(message: Any, frame: str = WORLD_FRAME) -> Vector:
    """Return the state, shape (6,), of a PoseStamped in the given frame or without one.

    Raises
    ------
    InvalidStateError
        If the frame is neither `frame` nor empty, or see `pose_from_ros`.
    """
    given = message.header.frame_id
    if given not in ("", frame):
        raise InvalidStateError("frame", given, f"'{frame}' (world_frame) or none")
    return pose_from_ros(message)


def transform_from_pose(
    message: PoseStamped, body_frame: str = BODY_FRAME
) -> TransformStamped:
    """Return the transform from the body to the frame of its pose."""
    transform = TransformStamped(header=message.header, child_frame_id=body_frame)
    place, shift = message.pose.position, transform.transform.translation
    shift.x, shift.y, shift.z = place.x, place.y, place.z
    transform.transform.rotation = message.pose.orientation
    return transform


def odometry_to_ros(
    state: Vector, velocity: Vector, body_rate: Vector, stamp: int, shell_radius: float,
    body_frame: str = BODY_FRAME, frame: str = WORLD_FRAME,
) -> Odometry:
    """Return pose and twist, the twist in the body frame as Odometry demands.

    Parameters
    ----------
    state, stamp, shell_radius, frame
        See `pose_to_ros`.
    velocity : ndarray, shape (3,)
        Velocity of the centre [m/s; world frame].
    body_rate : ndarray, shape (3,)
        Angular velocity [rad/s; body frame].
    body_frame : str, optional
        Name of the body frame.
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


def joint_states_to_ros(angles: Vector, speeds: Vector, torques: Vector, stamp: int) -> JointState:
    """Return rotor angles [rad], speeds [rad/s] and motor torques [N m], each of shape (2,)."""
    message = JointState()
    message.header.stamp = stamp_to_ros(stamp)
    message.name = list(JOINT_NAMES)
    message.position = angles.tolist()
    message.velocity = speeds.tolist()
    message.effort = torques.tolist()
    return message


def joint_states_from_ros(message: Any) -> tuple[Vector, Vector, Vector]:
    """Return rotor angles [rad], speeds [rad/s] and torques [N m], rotor 1 first.

    Raises
    ------
    InvalidInputError
        If the names are not those of the rotors.
    """
    order = _order_of_rotors(message.name)
    parts = (message.position, message.velocity, message.effort)
    angles, speeds, torques = (np.array(part, dtype=float)[order] for part in parts)
    return angles, speeds, torques


def rotor_speeds_from_ros(message: Any) -> Vector | None:
    """Return the rotor speeds [rad/s], shape (2,), of a JointState with any further joints.

    None if a rotor is missing or its speed is, or is not a finite number.
    """
    names, given = list(message.name), message.velocity
    if len(given) != len(names) or any(name not in names for name in JOINT_NAMES):
        return None
    speeds = np.array([given[names.index(name)] for name in JOINT_NAMES])
    return speeds if np.isfinite(speeds).all() else None


def hold_to_trajectory(hold: FirstOrderHold, epoch: int = 0) -> JointTrajectory:
    """Return a first-order hold as velocity-only points, stamped with the time of its first knot.

    A controller that interpolates the speeds linearly, as ros2_controllers' joint trajectory
    controller does with velocities alone, moves the rotors exactly as planned.

    Parameters
    ----------
    hold : FirstOrderHold
        Rotor speeds [rad/s] over control time [s].
    epoch : int, optional
        Stamp [ns] of control time 0.
    """
    start = stamp_of(hold.start, epoch)
    message = JointTrajectory(joint_names=list(JOINT_NAMES))
    message.header.stamp = stamp_to_ros(start)
    for time, speeds in zip(hold.times.tolist(), hold.speeds.tolist(), strict=True):
        point = JointTrajectoryPoint(velocities=speeds)
        after, rest = divmod(stamp_of(time, epoch) - start, NANOSECONDS)
        point.time_from_start.sec, point.time_from_start.nanosec = after, rest
        message.points.append(point)
    return message


def hold_from_trajectory(message: Any, now: int, epoch: int = 0) -> FirstOrderHold:
    """Return the first-order hold of a trajectory; rotors are matched by name, in any order.

    Parameters
    ----------
    message : JointTrajectory
        Points need velocities [rad/s]; positions and accelerations are ignored.
    now : int
        Start [ns] of a trajectory with stamp 0, which means "now".
    epoch : int, optional
        Stamp [ns] of control time 0.

    Raises
    ------
    InvalidInputError
        If the names are not those of the rotors, a point lacks a velocity or has one that is not
        finite, or the times do not rise.
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
