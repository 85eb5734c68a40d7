# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Objects of rclpy from and to arrays and stamps [ns], of messages that are rare or for displays.

The others are read and written as they are sent, see `sphere_nmpc.ros.cdr`. What cannot be read or
used raises an `InvalidStateError`, where it is a pose, or an `InvalidInputError`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message

from sphere_nmpc.errors import Description, InvalidInputError, InvalidStateError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import (
    FARTHEST,
    POSITION,
    QUATERNION,
    Vector,
    make_state,
    upright_state,
)
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.cdr import BODY_FRAME, WORLD_FRAME, stamp_of

MOST_GOALS = 500
"""Goals of a list, which take some 30 ms to be read."""
MOST_PLACES = 10_000
"""Poses of a path, which take half a second to be read and made a curve; 400 take 40 ms."""


def stamp_to_ros(stamp: int) -> Time:
    """Return a stamp [ns] as a message."""
    seconds, rest = divmod(stamp, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def stamp_from_ros(message: Any) -> int:
    """Return a Time or Duration message as whole nanoseconds."""
    return int(message.sec) * NANOSECONDS + int(message.nanosec)


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
    _check_frame(message.header.frame_id, frame)
    return pose_from_ros(message)


def framed_poses_from_ros(
    messages: Sequence[Any], common: str, frame: str = WORLD_FRAME
) -> list[Vector]:
    """Return the states of PoseStampeds, each as `framed_pose_from_ros`, `MOST_GOALS` at most.

    Those without a frame are in the `common` one, that of their list, which they are given.
    """
    if len(messages) > MOST_GOALS:
        given = Description(f"{len(messages)} goals")
        raise InvalidStateError("goals", given, f"at most {MOST_GOALS}")
    for message in messages:
        message.header.frame_id = message.header.frame_id or common
    return [framed_pose_from_ros(message, frame) for message in messages]


def framed_places_from_ros(message: Any, frame: str = WORLD_FRAME) -> Vector:
    """Return the positions [m], shape (P, 2), of a nav_msgs/Path, `MOST_PLACES` at most.

    Each pose is in the given frame, or without one; those without one are in that of the path.
    Nothing else of them counts, as planners do not set it.
    """
    poses, given = message.poses, Description(f"{len(message.poses)} poses")
    if not 0 < len(poses) <= MOST_PLACES:
        raise InvalidStateError("path", given, f"1 to {MOST_PLACES}; ~/cancel stops")
    for other in {pose.header.frame_id or message.header.frame_id for pose in poses}:
        _check_frame(other, frame)
    places = np.array([(it.pose.position.x, it.pose.position.y) for it in poses])
    wrong = np.flatnonzero(~(np.abs(places) <= FARTHEST).all(axis=1))
    if wrong.size:
        raise InvalidStateError(
            f"pose {wrong[0]} of the path", places[wrong[0]].tolist(),
            f"finite numbers [x, y], at most {FARTHEST:g} m from the origin along each axis",
        )
    return places


def framed_point_from_ros(message: Any, frame: str = WORLD_FRAME) -> Vector:
    """Return the upright state, shape (6,), at a PointStamped; otherwise as for a pose."""
    _check_frame(message.header.frame_id, frame)
    return upright_state(message.point.x, message.point.y, 0.0)


def odometry_to_ros(
    state: Vector, velocity: Vector, body_rate: Vector, stamp: int, shell_radius: float,
    body_frame: str = BODY_FRAME, frame: str = WORLD_FRAME,
    covariances: tuple[Vector, Vector] | None = None,
) -> Odometry:
    """Return pose and twist, the twist in the body frame as Odometry demands.

    `velocity` is that of the centre [m/s; world frame], shape (3,), `body_rate` the angular
    velocity [rad/s; body frame], shape (3,); `covariances` are those of pose, about the fixed axes
    of the world, and twist, shape (6, 6) each, None where they are not known. For the others see
    `pose_message`.
    """
    message = Odometry()
    message.header.stamp = stamp_to_ros(stamp)
    message.header.frame_id = frame
    message.child_frame_id = body_frame
    _fill_pose(message.pose.pose, state, shell_radius)
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, linear.z = rotation.to_body(state[QUATERNION], velocity)
    angular.x, angular.y, angular.z = (float(value) for value in body_rate)
    if covariances is not None:
        message.pose.covariance, message.twist.covariance = (one.ravel() for one in covariances)
    return message


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


def _check_frame(given: str, frame: str) -> None:
    if given not in ("", frame):
        raise InvalidStateError("frame", given, f"'{frame}' (world_frame) or none")


def _fill_pose(pose: Any, state: Vector, height: float) -> None:
    place, turn = pose.position, pose.orientation
    place.x, place.y = state[POSITION].tolist()
    place.z = height
    turn.w, turn.x, turn.y, turn.z = state[QUATERNION].tolist()
