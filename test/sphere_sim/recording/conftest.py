# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Small bags of a sphere that rolls to its goal, made without ROS."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sphere_sim.recording.bag_writer import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
START, STEP, COUNT = 5_000_000_000, 10_000_000, 301
Entry = tuple[str, str, int, Any]


def make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(stamp: int) -> Any:
    time = make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return make("std_msgs/msg/Header", stamp=time, frame_id="world")


def pose(stamp: int, state: Any) -> Any:
    x, y, qw, qx, qy, qz = (float(value) for value in state)
    return make(
        "geometry_msgs/msg/PoseStamped",
        header=header(stamp),
        pose=make(
            "geometry_msgs/msg/Pose",
            position=make("geometry_msgs/msg/Point", x=x, y=y, z=0.3),
            orientation=make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        ),
    )


def joints(stamp: int, speeds: Any, names=("rotor_2_joint", "rotor_1_joint")) -> Any:
    """Rotor 2 first: who reads by index will be wrong."""
    turned = np.array(speeds[::-1], dtype=float)
    return make(
        "sensor_msgs/msg/JointState", header=header(stamp), name=list(names),
        position=np.zeros(2), velocity=turned, effort=turned / 100.0,
    )


def trajectory(stamp: int, speeds: Any) -> Any:
    points = [
        make(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=np.empty(0), velocities=np.array(speed, dtype=float),
            accelerations=np.empty(0), effort=np.empty(0),
            time_from_start=make(
                "builtin_interfaces/msg/Duration", sec=0, nanosec=i * 500_000_000
            ),
        )
        for i, speed in enumerate(speeds)
    ]
    return make(
        "trajectory_msgs/msg/JointTrajectory", header=header(stamp),
        joint_names=["rotor_1_joint", "rotor_2_joint"], points=points,
    )


def status(time: float, solve_time: float, cost: float) -> Any:
    values = {"time_s": time, "plan": "solved", "solve_time_s": solve_time, "cost": cost}
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus", level=0, name="controller", message="",
        hardware_id="sphere",
        values=[make("diagnostic_msgs/msg/KeyValue", key=k, value=str(v))
                for k, v in values.items()],
    )


def state_at(i: int) -> np.ndarray:
    """Exponential approach to the origin, turning about z, with a jump of the sign half way."""
    decay = np.exp(-4.0 * i / COUNT * 2.5)
    half = 0.5 * decay
    state = np.array([2.0 * decay, -decay, np.cos(half), 0.0, 0.0, np.sin(half)])
    return state * np.array([1, 1, *([-1] * 4)]) if i > COUNT // 2 else state


def run_messages(namespace: str = "") -> Iterator[Entry]:
    """Yield topic, type, stamp and message of a whole run."""
    kind = "geometry_msgs/msg/PoseStamped"
    goal = pose(0, (0, 0, 1, 0, 0, 0))
    yield f"{namespace}/goal_pose", kind, START, goal
    yield f"{namespace}/controller/active_goal", kind, START, goal
    for i in range(COUNT):
        now = START + i * STEP
        yield f"{namespace}/pose", kind, now, pose(now, state_at(i))
        speeds = (100.0 - i / 10.0, -50.0)
        yield f"{namespace}/joint_states", "sensor_msgs/msg/JointState", now, joints(now, speeds)
        if i % 50 == 0:
            plan = trajectory(now, ((1.0, 2.0), (3.0, 4.0)))
            yield f"{namespace}/rotor_trajectory", "trajectory_msgs/msg/JointTrajectory", now, plan
            told = status(now / 1e9, 1e-3 * (1 + i), 10.0 / (1 + i))
            kind_of_status = "diagnostic_msgs/msg/DiagnosticStatus"
            yield f"{namespace}/controller/status", kind_of_status, now, told


def write_own(folder: Path, entries: Any) -> Path:
    writer = BagWriter(folder)
    for topic, kind, stamp, message in entries:
        writer.add_topic(topic, kind)
        writer.write(topic, stamp, bytes(STORE.serialize_cdr(message, kind)))
    writer.close()
    return folder


def write_foreign(folder: Path, entries: Any, plugin: StoragePlugin) -> Path:
    """Write a bag as ``ros2 bag record`` lays it out."""
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp, message in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], stamp, STORE.serialize_cdr(message, kind))
    return folder


@pytest.fixture
def messages() -> Callable[..., Iterator[Entry]]:
    return run_messages


@pytest.fixture
def make_bag(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes messages in one of the three kinds of bag."""

    def write(entries: Any, kind: str = "own") -> Path:
        folder = tmp_path / f"bag_{kind}"
        if kind == "own":
            return write_own(folder, entries)
        return write_foreign(folder, entries, StoragePlugin[kind.upper()])

    return write
