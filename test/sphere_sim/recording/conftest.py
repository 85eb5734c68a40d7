# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Small bags of a sphere that rolls to its goal, of the recorder and as rosbag2 writes them."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

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
    """Return joint states with rotor 2 first, for which reading by index would be wrong."""
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


def status(time: float, solve_time: float, cost: float, **more: float) -> Any:
    values = {"time_s": time, "plan": "solved", "solve_time_s": solve_time, "cost": cost, **more}
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus", level=0, name="controller", message="",
        hardware_id="sphere",
        values=[make("diagnostic_msgs/msg/KeyValue", key=k, value=str(v))
                for k, v in values.items()],
    )


def state_at(i: int) -> np.ndarray:
    """Return a state that approaches the origin exponentially, with a change of sign half way."""
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
            solve = status(now / 1e9, 1e-3 * (1 + i), 10.0 / (1 + i))
            kind_of_status = "diagnostic_msgs/msg/DiagnosticStatus"
            yield f"{namespace}/controller/status", kind_of_status, now, solve


def momentum_messages() -> Iterator[Entry]:
    """Yield a run that is pushed after 1 s, and whose controller finds the momentum at 1.5 s.

    The statuses without a solve, as of a sphere at its goal, report momentum too.
    """
    yield from (entry for entry in run_messages() if not entry[0].endswith("/status"))
    pushed = make(
        "geometry_msgs/msg/Vector3Stamped", header=header(START + 100 * STEP),
        vector=make("geometry_msgs/msg/Vector3", x=0.5, y=-0.25, z=0.0),
    )
    # Logged late, as by a busy recorder.
    kind = "geometry_msgs/msg/Vector3Stamped"
    yield "/simulator/pushed", kind, START + 101 * STEP, pushed
    for i in range(0, COUNT, 50):
        now, found = START + i * STEP, float(i >= 150)
        values = {"momentum_x": 0.075 * found, "momentum_y": 0.15 * found, "momentum_z": 0.0,
                  "slope_deg": 0.5 * found, "slope_direction_deg": 90.0 * found}
        offsets = {f"mass_offset_{axis}_mm": found for axis in "xyz"}
        message = status(now / 1e9, 0.0, 0.0, **values, **offsets)
        yield "/controller/status", "diagnostic_msgs/msg/DiagnosticStatus", now, message


def write_own(folder: Path, entries: Any) -> Path:
    writer = BagWriter(folder)
    for topic, kind, stamp, message in entries:
        writer.add_topic(topic, kind)
        writer.write(topic, stamp, bytes(STORE.serialize_cdr(message, kind)))
    writer.close()
    return folder


def write_foreign(folder: Path, entries: Any, plugin: StoragePlugin) -> Path:
    """Write a bag with the writer of ``rosbags``."""
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
def messages_with_momentum() -> Callable[..., Iterator[Entry]]:
    return momentum_messages


@pytest.fixture
def make_bag(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes messages into a bag of a kind: own, mcap or sqlite3."""

    def write(entries: Any, kind: str = "own") -> Path:
        folder = tmp_path / f"bag_{kind}"
        if kind == "own":
            return write_own(folder, entries)
        return write_foreign(folder, entries, StoragePlugin[kind.upper()])

    return write


def as_rosbag2(
    folder: Path, entries: Sequence[Entry], kind: str, compression: str = "", parts: int = 2,
    custom: dict[str, str] | None = None,
) -> Path:
    """Write messages, or their serialised bytes, as ``ros2 bag record`` does.

    The storage files are called folder_0, folder_1, …, with the suffix ``.zstd`` if files are
    compressed; metadata.yaml lists them in order, and the mode of compression in capitals.
    """
    folder.mkdir()
    yaml, descriptions, names = YAML(typ="safe"), [], []
    for i in range(parts):
        part = folder.parent / f"{folder.name}_part{i}"
        writer = Writer(part, version=9, storage_plugin=StoragePlugin[kind.upper()])
        if compression == "message":
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        for key, value in (custom or {}).items():
            writer.set_custom_data(key, value)
        with writer:
            connections = {}
            for topic, msgtype, _, _ in entries:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE)
            share = slice(len(entries) * i // parts, len(entries) * (i + 1) // parts)
            for topic, msgtype, stamp, data in entries[share]:
                raw = data if isinstance(data, bytes) else STORE.serialize_cdr(data, msgtype)
                writer.write(connections[topic], stamp, raw)
        described = yaml.load((part / "metadata.yaml").read_text())
        descriptions.append(described["rosbag2_bagfile_information"])
        file = next(file for file in part.iterdir() if file.suffix in (".mcap", ".db3"))
        name = f"{folder.name}_{i}{file.suffix}"
        names.append(f"{name}.zstd" if compression == "file" else name)
        data = file.read_bytes()
        (folder / names[-1]).write_bytes(
            zstandard.compress(data) if compression == "file" else data
        )
    stamps = [entry[2] for entry in entries]
    for i, topic in enumerate(descriptions[0]["topics_with_message_count"]):
        topic["message_count"] = sum(
            it["topics_with_message_count"][i]["message_count"] for it in descriptions
        )
    about = descriptions[0] | {
        "relative_file_paths": names,
        "starting_time": {"nanoseconds_since_epoch": min(stamps)},
        "duration": {"nanoseconds": max(stamps) - min(stamps)},
        "message_count": len(entries),
        "compression_format": "zstd" if compression else "",
        "compression_mode": compression.upper(),
        "files": [
            it["files"][0] | {"path": name} for it, name in zip(descriptions, names, strict=True)
        ],
        "ros_distro": "jazzy",
    }
    with (folder / "metadata.yaml").open("w") as stream:
        yaml.default_flow_style = False
        yaml.dump({"rosbag2_bagfile_information": about}, stream)
    return folder


@pytest.fixture
def rosbag2(tmp_path: Path) -> Callable[..., Path]:
    """Return `as_rosbag2` for a folder of a name in the temporary folder."""
    return lambda entries, *how, name="mine", **more: as_rosbag2(
        tmp_path / name, list(entries), *how, **more
    )


def on_the_system_clock(entries: Sequence[Entry], goals_first: bool = True) -> list[Entry]:
    """Return entries with the log times of a recorder without simulated time.

    Log times are as irregular as on a busy machine. While simulated time is paused before the run,
    the first pose is repeated, and half way through this the goal is set, if `goals_first`.
    """
    rng = np.random.default_rng(7)
    goals = ("goal_pose", "active_goal") if goals_first else ()
    before = [entry for entry in entries if entry[0].endswith(goals)]
    after = [entry for entry in entries if entry not in before]
    pose = next(entry for entry in entries if entry[0].endswith("/pose"))
    order = [*[pose] * 15, *before, *[pose] * 15, *after]
    steps = [0.1] * (30 + len(before)) + list(rng.exponential(3e-4, len(after)))
    logs = 1_800_000_000_000_000_000 + np.round(np.cumsum(steps) * 1e9).astype(np.int64)
    return [(*entry[:2], int(log), entry[3]) for entry, log in zip(order, logs, strict=True)]


@pytest.fixture
def on_system_clock() -> Callable[..., list[Entry]]:
    return on_the_system_clock
