# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What identification needs of a bag: poses, rotor speeds, commands and readings of an IMU."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.quantity import LARGEST
from sphere_nmpc.ros import cdr
from sphere_sim.identification.drives import Commands
from sphere_sim.identification.inertial import Readings
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.bag_files import PARAMETERS_PREFIX, BagError, object_of
from sphere_sim.recording.messages import Messages, read_messages
from sphere_sim.recording.poses import read_poses
from sphere_sim.recording.run_reader import TopicReader
from sphere_sim.recording.topic_roles import Robot, find_robot, is_read

_IMU, _NUMBERS = cdr.TYPES[cdr.Imu], cdr.TYPES[cdr.Numbers]
_COMMANDS = "rotor_commands"
_OWN_POSES = "odometry/status"
"""Topic of a node that estimates poses from inside."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """Contents of a bag, with times in seconds since the first pose, or the first rotor speeds.

    Attributes
    ----------
    times, poses : ndarray, shapes (K,) and (K, 6)
        Poses.
    are_outside : bool
        Whether they are measured from outside, not estimated by an odometry of the same sensors.
    height : float
        Height of the centre in the poses [m], nan without poses.
    joint_times, speeds : ndarray, shapes (N,) and (N, 2)
        Rotor speeds [rad/s].
    commands : Commands, optional
    readings : Readings, optional
        Those of the IMU.
    parameters : dict
        Parameters of the controller in the bag, by name.
    notes : list of str
        What is missing or invalid in the bag.
    """

    times: Vector
    poses: Vector
    are_outside: bool
    height: float
    joint_times: Vector
    speeds: Vector
    commands: Commands | None
    readings: Readings | None
    parameters: dict[str, Any]
    notes: list[str]


def read_recorded(path: Path, namespace: str | None, pose_topic: str | None) -> Recorded:
    """Read the bag of one robot; for the errors see `sphere_sim.recording.run_reader.read_run`."""
    messages = read_messages(path, lambda topic, kind: (
        is_read(topic, kind) or kind == _IMU
        or (kind == _NUMBERS and topic.rpartition("/")[2] == _COMMANDS)
    ))
    has_poses = any(
        kind == cdr.TYPES[cdr.Pose] and topic.endswith("pose") and not topic.endswith("goal_pose")
        and topic in messages.decoded for topic, kind in messages.types.items()
    )
    if has_poses or pose_topic is not None:
        robot = find_robot(messages, namespace, pose_topic)
        clock, times, poses = read_poses(messages, robot.pose)
        height = float(messages.decoded[robot.pose][0][1].numbers[2])
    else:
        own = (namespace or "").rstrip("/")
        robot = Robot(own, f"{own}/controller", "", "", f"{own}/joint_states",
                      f"{own}/rotor_trajectory")
        entries = messages.decoded.get(robot.joint_states)
        if not entries:
            raise BagError(path, f"neither poses nor rotor speeds on {robot.joint_states}")
        clock = BagClock([log for log, _ in entries], [one.stamp for _, one in entries])
        times, poses, height = np.empty(0), np.empty((0, 6)), float("nan")
    reader = TopicReader(messages, robot, clock)
    joint_times, speeds, _ = reader.joint_states()
    known = np.all(np.isfinite(speeds), axis=1)
    if not known.any():
        joint_times, speeds = _speeds_of_angles(messages, robot, clock)
        known = np.ones(joint_times.size, dtype=bool)
    own = robot.namespace
    is_inside = f"{own}/{_OWN_POSES}" in messages.types and not robot.estimate
    return Recorded(
        times, poses, bool(times.size) and not (is_inside and pose_topic is None), height,
        joint_times[known], speeds[known], _commands(messages, robot, clock, reader),
        _readings(messages, own, clock),
        object_of(messages.custom_data.get(f"{PARAMETERS_PREFIX}{robot.controller}", "")),
        messages.notes,
    )


def _speeds_of_angles(
    messages: Messages, robot: Robot, clock: BagClock
) -> tuple[Vector, Vector]:
    """Return times [s] and speeds (N, 2) [rad/s] by the angles of rotors without velocities."""
    found: Vector = np.array([
        (clock.time_of_stamp(one.stamp), *rotors[0])
        for _, one in messages.decoded.get(robot.joint_states, ())
        if (rotors := one.of_rotors()) is not None and np.isfinite(rotors[0]).all()
    ]).reshape(-1, 3)
    _, first = np.unique(found[:, 0], return_index=True)
    times, angles = found[first, 0], np.unwrap(found[first, 1:], axis=0)
    if times.size < 2 or not np.ptp(angles):
        return np.empty(0), np.empty((0, INPUT_SIZE))
    messages.notes.append(f"{robot.joint_states}: no velocities; the speeds are those of angles")
    return 0.5 * (times[1:] + times[:-1]), np.diff(angles, axis=0) / np.diff(times)[:, None]


def _commands(
    messages: Messages, robot: Robot, clock: BagClock, reader: TopicReader
) -> Commands | None:
    """Return the commands of a robot: trajectories, or else speeds at their log times."""
    holds = reader.plans() if robot.rotor_trajectory in messages.decoded else ()
    if holds:
        return Commands.of_holds(holds)
    found = [
        (clock.time_of_log(log), message.numbers)
        for log, message in messages.decoded.get(f"{robot.namespace}/{_COMMANDS}", ())
        if message.numbers.size == INPUT_SIZE and np.all(np.abs(message.numbers) <= LARGEST)
    ]
    if len(found) < 2:
        return None
    times, first = np.unique([time for time, _ in found], return_index=True)
    return Commands.of_speeds(times, np.array([found[i][1] for i in first]))


def _readings(messages: Messages, namespace: str, clock: BagClock) -> Readings | None:
    """Return the readings of the IMU in a namespace, or of the only one."""
    topics = [topic for topic, kind in messages.types.items()
              if kind == _IMU and topic in messages.decoded]
    own = [topic for topic in topics if topic == f"{namespace}/imu"] or topics
    if not own:
        return None
    if len(own) > 1:
        messages.notes.append(f"{', '.join(sorted(own))}: several IMUs, none is used")
        return None
    numbers = np.array([
        (clock.time_of_stamp(one.stamp), *one.rate, *one.force)
        for _, one in messages.decoded[own[0]]
    ])
    numbers = numbers[np.all(np.isfinite(numbers) & (np.abs(numbers) <= LARGEST), axis=1)]
    _, first = np.unique(numbers[:, 0], return_index=True)
    times, rates, forces = numbers[first, 0], numbers[first, 1:4], numbers[first, 4:]
    return Readings(times, rates, forces) if times.size > 1 else None
