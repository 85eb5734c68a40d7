# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bag with what an odometry gets: readings of an IMU and of encoders, poses measured elsewhere."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidInputError, InvalidValueError
from sphere_nmpc.model.state import POSE_SIZE, Vector, are_states
from sphere_nmpc.quantities import LARGEST, counted
from sphere_nmpc.ros.cdr import JOINT_NAMES, TYPES, Imu, Joints, Pose, UncertainPose
from sphere_sim.evaluation.followed_odometry import FollowedOdometry
from sphere_sim.evaluation.series import Series
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.bag_files import BagError, full_topic_name, last_part
from sphere_sim.recording.message_fields import TRUE_POSE
from sphere_sim.recording.messages import Messages, read_messages
from sphere_sim.recording.poses import read_series
from sphere_sim.recording.run import without_sign_jumps

FIX, PLACED = "pose_fix", "initialpose"
"""Last parts of the topics of poses that were measured elsewhere, or given."""
Event = tuple[float, str, Any]
"""Time since the first reading of the IMU [s], topic and record of a message."""
_KINDS = {TYPES[kind] for kind in (Imu, Joints, Pose, UncertainPose)}
_CHECK_EVERY = 0.25
"""Time between two checks of the sensors, as the node makes them [s]."""
_FEWEST = 2
"""Readings below which there is no rate."""


@dataclass(frozen=True, eq=False)
class SensorBag:
    """Messages of one robot in a bag, by their roles.

    Attributes
    ----------
    messages : Messages
        All of them, with their notes.
    imu, joints, reference : str
        Topics; the last two are empty where there are none.
    """

    messages: Messages
    imu: str
    joints: str
    reference: str

    @property
    def namespace(self) -> str:
        """Namespace of the robot, without a slash at its end."""
        return (self.joints or self.imu).rpartition("/")[0]

    def of(self, topic: str) -> list[tuple[int, Any]]:
        """Return log times [ns] and records of a topic, in their order."""
        return self.messages.decoded.get(topic, [])

    def events(self) -> tuple[list[Event], dict[str, Series]]:
        """Return what an odometry gets, as it was logged, and poses to compare it with.

        The latter are by topic: the reference and the fixes. Times are those of the stamps, or of
        the log where these cannot be used.
        """
        readings = self.of(self.imu)
        try:
            readings[0][1].check_measured()
        except InvalidInputError as error:
            raise BagError(self.messages.path, f"{self.imu}: {error}") from None
        numbers: Vector = np.array([(*it.rate, *it.force) for _, it in readings])
        valid = np.all(np.abs(numbers) <= LARGEST, axis=1, keepdims=True)[:, 0]
        if (count := int(np.count_nonzero(valid))) < _FEWEST:
            reason = f"{self.imu} has {counted(count, 'finite reading')}, expected more"
            raise BagError(self.messages.path, reason)
        if count < len(valid):
            self.messages.notes.append(
                f"{self.imu}: {len(valid) - count} readings that are not finite were ignored"
            )
        kept, stamps = read_series(self.messages, self.imu, numbers, valid, "readings")
        clock = BagClock([readings[i][0] for i in kept], stamps)
        found = [(readings[i][0], (clock.time_of_stamp(stamp), self.imu, readings[i][1]))
                 for i, stamp in zip(kept, stamps, strict=True)]
        own = [_nearest(self.imu, [it for it in self.messages.decoded if last_part(it) == kind])
               for kind in (FIX, PLACED)]
        compared = {}
        for topic in filter(None, dict.fromkeys((self.joints, *own, self.reference))):
            times = np.array([clock.time_of_record(topic, *entry) for entry in self.of(topic)])
            if topic != self.reference:
                found += [(log, (time, topic, record)) for time, (log, record)
                          in zip(times.tolist(), self.of(topic), strict=True)]
            if topic in (own[0], self.reference):
                given = [record.state for _, record in self.of(topic)]
                states: Vector = np.array(given, dtype=float).reshape(-1, POSE_SIZE)
                poses = Series.of_numbers(times, states)
                poses = poses.where(are_states(poses.values))
                compared[topic] = replace(poses, values=without_sign_jumps(poses.values))
        del clock.undated[own[1]]  # stamped by who gives it, on any clock
        self.messages.notes += clock.notes("the IMU")
        found.sort(key=lambda entry: entry[0])
        return [event for _, event in found], compared


def read_sensor_bag(
    path: Path, imu: str | None = None, pose_topic: str | None = None
) -> SensorBag:
    """Read a bag with one IMU, or with several of which one is given by its topic.

    Poses are compared with those of `pose_topic`, by default with ``ground_truth/pose`` or
    ``pose`` of the robot. `BagError` is raised where there is no such topic.
    """
    messages = read_messages(path, lambda _, kind: kind in _KINDS)
    imus = messages.recorded(TYPES[Imu])
    if imu is None and len(imus) > 1:
        raise BagError(path, f"has several IMUs, choose one with --imu: {', '.join(imus)}")
    wanted = imus if imu is None else [full_topic_name(imu)]
    if not imus or wanted[0] not in imus:
        others = imus or sorted(messages.types)
        missing = f"no message of type {TYPES[Imu]}{'' if imu is None else f' on {wanted[0]}'}"
        missing = messages.incomplete(missing) if messages.truncated else missing
        raise BagError(path, f"{missing}; it has: {', '.join(others) or 'no topic'}")
    (imu, *_) = wanted
    joints = messages.recorded(TYPES[Joints])
    rotors = [topic for topic in joints if any(
        record.of_rotors() is not None for _, record in messages.decoded[topic]
    )]
    if joints and not rotors:
        messages.notes.append(f"no joint states name {' and '.join(JOINT_NAMES)}")
    poses = messages.recorded(TYPES[Pose])
    if pose_topic is not None and (pose_topic := full_topic_name(pose_topic)) not in poses:
        raise BagError(path, f"no poses on {pose_topic}; it has: {', '.join(poses) or 'none'}")
    own = [topic for topic in poses if topic.endswith(f"/{TRUE_POSE}")]
    own = own or [topic for topic in poses if last_part(topic) == "pose"]
    return SensorBag(
        messages, imu, _nearest(imu, rotors or joints), pose_topic or _nearest(imu, own)
    )


def feed(
    events: Iterable[Event], followed: FollowedOdometry, frame: str
) -> dict[str, list[str]]:
    """Pass events to an odometry as its node does; return why messages are refused, by topic."""
    odometry, refused, checked = followed.odometry, dict[str, list[str]](), 0.0
    for time, topic, record in events:
        try:
            is_new = isinstance(record, Imu)
            if isinstance(record, Imu):
                record.check_measured()
                odometry.observe_imu(time, np.array(record.rate), np.array(record.force))
            elif isinstance(record, Joints):
                if (rotors := record.of_rotors()) is not None:
                    angles, speeds, _ = rotors
                    known = angles if np.isfinite(angles).all() else None
                    is_new = odometry.observe_rotors(time, speeds, known)
            elif last_part(topic) == FIX:
                odometry.correct(time, *record.in_frame(frame))
            else:  # the stamp of who gives it is that of another clock
                estimate = odometry.estimate
                now = time if estimate is None else estimate.time
                odometry.set_pose(now, *record.in_frame(frame))
            if is_new:
                if time > checked + _CHECK_EVERY:
                    odometry.check(time)
                    checked = time
                followed.read(time)
        except InvalidValueError as error:
            refused.setdefault(topic, []).append(str(error))
    return refused


def _nearest(topic: str, others: Sequence[str]) -> str:
    """Return the topic that shares most of its namespace with another one; empty without any."""
    def shared(other: str) -> int:
        pairs = zip(topic.split("/")[:-1], other.split("/")[:-1], strict=False)
        return next((i for i, (a, b) in enumerate(pairs) if a != b), topic.count("/"))

    return max(others, key=shared, default="")
