# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags of simulated motions with what an odometry gets."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from inertial_runs import IMU, SECOND, Run

from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import TYPES, Imu, Joints, Pose, UncertainPose
from sphere_nmpc.ros.cdr_messages import imu_message, joint_states_message, pose_message
from sphere_sim.recording.bag_writer import BagWriter

EPOCH = 5 * SECOND
"""Stamp of time 0 of a run [ns]."""
PARAMETERS = f"""/**:
  ros__parameters:
    imu: {{position: {list(IMU.position)}, orientation: {list(IMU.orientation)}}}
"""
"""File with the mounting of the IMU of `inertial_runs`."""
Entry = tuple[str, type, int, bytes]
"""Topic, record of the type, log time [ns] and message."""


def sensor_entries(
    run: Run, imu: str = "/imu", truth: str = "/ground_truth/pose"
) -> Iterator[Entry]:
    """Yield the messages of a run in their order, with true poses also of the rest before it."""
    for one in run.readings:
        stamp = one.stamp + EPOCH
        message = imu_message(one.rate, one.force, IMU.deviations, stamp, "imu")
        yield imu, Imu, stamp, message
        message = joint_states_message(one.angles, one.speeds, one.torques, stamp)
        yield "/joint_states", Joints, stamp, message
        state = run.states.get(max(one.stamp, 0))
        if state is not None:
            yield truth, Pose, stamp, pose_message(state, stamp, 0.3)


def uncertain_pose(
    topic: str, state: Vector, time: float, late: float = 0.1, variance: float = 1e-6
) -> Entry:
    """Return a pose that was measured at a time of a run [s] and logged later [s]."""
    stamp = EPOCH + round(time * SECOND)
    covariance: Vector = variance * np.eye(6)
    message = pose_message(state, stamp, 0.3) + covariance.tobytes()
    return topic, UncertainPose, stamp + round(late * SECOND), message


def write_sensors(
    folder: Path, entries: Iterable[Entry], custom: Mapping[str, str] = {}
) -> Path:
    """Write a bag, and return it."""
    writer = BagWriter(folder)
    writer.custom_data.update(custom)
    for topic, record, log, message in sorted(entries, key=lambda entry: entry[2]):
        writer.add_topic(topic, TYPES[record])
        writer.write(topic, log, message)
    writer.close()
    return folder
