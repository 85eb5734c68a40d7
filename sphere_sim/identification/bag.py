# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What identification needs of a bag: poses, rotor speeds, commands and readings of an IMU."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.quantities import LARGEST
from sphere_nmpc.ros import cdr
from sphere_sim.evaluation.series import RobotSeries, Series
from sphere_sim.identification.drives import Commands
from sphere_sim.identification.inertial import Readings
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.bag_files import BagError, last_part
from sphere_sim.recording.messages import Messages, read_messages
from sphere_sim.recording.node_parameters import bag_parameters
from sphere_sim.recording.poses import read_poses
from sphere_sim.recording.run_reader import TopicReader
from sphere_sim.recording.topic_roles import Robot, find_robot, is_read

_IMU, _NUMBERS = cdr.TYPES[cdr.Imu], cdr.TYPES[cdr.Numbers]
_COMMANDS = "rotor_commands"
_OWN_POSES = "odometry/status"
"""Topic of a node that estimates poses from inside."""


@dataclass(frozen=True, eq=False)
class Recorded(RobotSeries):
    """Contents of a bag, with times in seconds since the first pose, or the first rotor speeds.

    Attributes
    ----------
    are_outside : bool
        Whether poses are measured from outside, not estimated by an odometry of the same sensors.
    height : float
        Height of the centre in the poses [m], nan without poses.
    commands : Commands, optional
    readings : Readings, optional
        Those of the IMU.
    controller : str
        Full name of the node of the controller.
    parameters : dict of str to str
        Texts of its parameters in the bag, by name.
    notes : list of str
        What is missing or invalid in the bag.
    """

    are_outside: bool
    height: float
    commands: Commands | None
    readings: Readings | None
    controller: str
    parameters: dict[str, str]
    notes: list[str]


def read_recorded(path: Path, namespace: str | None, pose_topic: str | None) -> Recorded:
    """Read the bag of one robot; for the errors see `sphere_sim.recording.run_reader.read_run`."""
    messages = read_messages(path, lambda topic, kind: (
        is_read(topic, kind) or kind == _IMU
        or (kind == _NUMBERS and last_part(topic) == _COMMANDS)
    ))
    poses_on = [topic for topic in messages.recorded(cdr.TYPES[cdr.Pose])
                if topic.endswith("pose") and not topic.endswith("goal_pose")]
    if poses_on or pose_topic is not None:
        robot = find_robot(messages, namespace, pose_topic)
        clock, poses = read_poses(messages, robot.pose)
        height = float(messages.decoded[robot.pose][0][1].numbers[2])
    else:
        own = (namespace or "").rstrip("/")
        robot = Robot(own, f"{own}/controller", "", "", f"{own}/joint_states",
                      f"{own}/rotor_trajectory")
        entries = messages.decoded.get(robot.joint_states)
        if not entries:
            raise BagError(path, f"neither poses nor rotor speeds on {robot.joint_states}")
        clock = BagClock([log for log, _ in entries], [one.stamp for _, one in entries])
        poses, height = Series(values=np.empty((0, 6))), float("nan")
    reader = TopicReader(messages, robot, clock)
    speeds, torques = reader.joint_states()
    known = speeds.where(np.all(np.isfinite(speeds.values), axis=1))
    own = robot.namespace
    is_inside = f"{own}/{_OWN_POSES}" in messages.types and not robot.estimate
    return Recorded(
        poses, known or _speeds_of_angles(messages, robot, clock), torques,
        bool(poses) and not (is_inside and pose_topic is None), height,
        _commands(messages, robot, clock, reader), _readings(messages, own, clock),
        robot.controller, bag_parameters(messages.custom_data, robot.controller), messages.notes,
    )


def _speeds_of_angles(messages: Messages, robot: Robot, clock: BagClock) -> Series:
    """Return the rotor speeds [rad/s] by the angles of rotors without velocities."""
    found = _series((
        (clock.time_of_stamp(one.stamp), *rotors[0])
        for _, one in messages.decoded.get(robot.joint_states, ())
        if (rotors := one.of_rotors()) is not None and np.isfinite(rotors[0]).all()
    ), INPUT_SIZE)
    times, angles = found.times, np.unwrap(found.values, axis=0)
    if times.size < 2 or not np.ptp(angles):
        return Series(values=np.empty((0, INPUT_SIZE)))
    messages.notes.append(f"{robot.joint_states}: no velocities; the speeds are those of angles")
    speeds = np.diff(angles, axis=0) / np.diff(times)[:, None]
    return Series(0.5 * (times[1:] + times[:-1]), speeds)


def _commands(
    messages: Messages, robot: Robot, clock: BagClock, reader: TopicReader
) -> Commands | None:
    """Return the commands of a robot: trajectories, or else speeds at their log times."""
    if robot.rotor_trajectory in messages.decoded and (plans := reader.plans()):
        return Commands.of_holds(plans.values)
    found = _series((
        (clock.time_of_log(log), *message.numbers)
        for log, message in messages.decoded.get(f"{robot.namespace}/{_COMMANDS}", ())
        if message.numbers.size == INPUT_SIZE
    ), INPUT_SIZE)
    return Commands.of_speeds(found) if len(found) > 1 else None


def _readings(messages: Messages, namespace: str, clock: BagClock) -> Readings | None:
    """Return the readings of the IMU in a namespace, or of the only one."""
    topics = messages.recorded(_IMU)
    own = [topic for topic in topics if topic == f"{namespace}/imu"] or topics
    if not own:
        return None
    if len(own) > 1:
        messages.notes.append(f"{', '.join(own)}: several IMUs, none is used")
        return None
    found = _series((
        (clock.time_of_stamp(one.stamp), *one.rate, *one.force)
        for _, one in messages.decoded[own[0]]
    ), 6)
    rates, forces = np.split(found.values, 2, axis=1)
    return Readings(found.times, rates, forces) if len(found) > 1 else None


def _series(rows: Iterable[Sequence[float]], size: int) -> Series:
    """Return the series of times [s] with `size` numbers each, where these are known."""
    table: Vector = np.array(list(rows), dtype=float).reshape(-1, 1 + size)
    table = table[np.all(np.abs(table[:, 1:]) <= LARGEST, axis=1)]
    return Series.of_numbers(table[:, 0], table[:, 1:])
