# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Small bags of a sphere, of the recorder and as rosbag2 writes them, and their messages."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from sphere_nmpc.model import rotation
from sphere_sim.recording.bag_writer import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
POSE, STATUS = "geometry_msgs/msg/PoseStamped", "diagnostic_msgs/msg/DiagnosticStatus"
FLOOR = "nav_msgs/msg/OccupancyGrid"
START, STEP, COUNT = 5_000_000_000, 10_000_000, 301
"""Stamp of the first pose of `run_messages`, their period [ns], and their number."""
Entry = tuple[str, str, int, Any]
"""Topic, type, log time [ns], and message or its bytes."""


def make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(stamp: int) -> Any:
    time = make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return make("std_msgs/msg/Header", stamp=time, frame_id="world")


def pose(stamp: int, state: Iterable[float]) -> Any:
    x, y, qw, qx, qy, qz = (float(value) for value in state)
    return make(
        POSE, header=header(stamp), pose=make(
            "geometry_msgs/msg/Pose",
            position=make("geometry_msgs/msg/Point", x=x, y=y, z=0.3),
            orientation=make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        ),
    )


def joints(stamp: int, speeds: Sequence[float]) -> Any:
    """Return joint states with rotor 2 first, for which reading by index would be wrong."""
    turned = np.array(speeds[::-1], dtype=float)
    return make(
        "sensor_msgs/msg/JointState", header=header(stamp),
        name=["rotor_2_joint", "rotor_1_joint"],
        position=np.zeros(2), velocity=turned, effort=turned / 100.0,
    )


def trajectory(stamp: int, speeds: Any) -> Any:
    none = np.empty(0)
    points = [
        make(
            "trajectory_msgs/msg/JointTrajectoryPoint", positions=none, accelerations=none,
            velocities=np.array(speed, dtype=float), effort=none, time_from_start=make(
                "builtin_interfaces/msg/Duration", sec=0, nanosec=i * 500_000_000
            ),
        )
        for i, speed in enumerate(speeds)
    ]
    return make(
        "trajectory_msgs/msg/JointTrajectory", header=header(stamp),
        joint_names=["rotor_1_joint", "rotor_2_joint"], points=points,
    )


def status(**values: object) -> Any:
    pairs = [make("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
             for key, value in values.items()]
    return make(STATUS, level=0, name="controller", message="", hardware_id="", values=pairs)


def run_messages(namespace: str = "") -> Iterator[Entry]:
    """Yield a run that approaches the origin exponentially, with a change of sign half way."""
    goal = pose(START, (0, 0, 1, 0, 0, 0))
    yield f"{namespace}/goal_pose", POSE, START, goal
    yield f"{namespace}/controller/active_goal", POSE, START, goal
    for i in range(COUNT):
        now, decay = START + i * STEP, np.exp(-4.0 * i / COUNT * 2.5)
        sign = -1.0 if i > COUNT // 2 else 1.0
        turn = sign * np.cos(0.5 * decay), 0.0, 0.0, sign * np.sin(0.5 * decay)
        yield f"{namespace}/pose", POSE, now, pose(now, (2.0 * decay, -decay, *turn))
        speeds = (100.0 - i / 10.0, -50.0)
        yield f"{namespace}/joint_states", "sensor_msgs/msg/JointState", now, joints(now, speeds)
        if i % 50 == 0:
            plan = trajectory(now, ((1.0, 2.0), (3.0, 4.0)))
            yield f"{namespace}/rotor_trajectory", "trajectory_msgs/msg/JointTrajectory", now, plan
            solve = status(
                time_s=now / 1e9, plan="solved", solve_time_s=1e-3 * (1 + i), cost=10.0 / (1 + i)
            )
            yield f"{namespace}/controller/status", STATUS, now, solve


def diagnostics(stamp: int, name: str, **values: object) -> Entry:
    """Return a message with one status at a stamp [ns]; underscores in keys stand for spaces."""
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    one = status(**{key.replace("_", " "): value for key, value in values.items()})
    one.name = name
    return "/diagnostics", kind, stamp, make(kind, header=header(stamp), status=[one])


def momentum_messages() -> Iterator[Entry]:
    """Yield a run that is pushed after 1 s, and whose controller finds the momentum at 1.5 s.

    The statuses without a solve, as of a sphere at its goal, report momentum too.
    """
    yield from (entry for entry in run_messages() if not entry[0].endswith("/status"))
    kind = "geometry_msgs/msg/Vector3Stamped"
    pushed = make(
        kind, header=header(START + 100 * STEP),
        vector=make("geometry_msgs/msg/Vector3", x=0.5, y=-0.25, z=0.0),
    )
    # Logged late, as by a busy recorder.
    yield "/simulator/pushed", kind, START + 101 * STEP, pushed
    for i in range(0, COUNT, 50):
        now, found = START + i * STEP, float(i >= 150)
        yield "/controller/status", STATUS, now, status(
            time_s=now / 1e9, plan="solved", solve_time_s=0.0, cost=0.0,
            momentum_x=0.075 * found, momentum_y=0.15 * found, momentum_z=0.0,
            slope_deg=0.5 * found, slope_direction_deg=90.0 * found,
            **{f"mass_offset_{axis}_mm": found for axis in "xyz"},
        )


def floor(stamp: int, occupied: Any, resolution: float, origin: Sequence[float]) -> Any:
    """Return a floor of cells, shape (H, W), whose first corner is at x, y [m] and yaw [rad].

    One of no cells is a free floor.
    """
    height, width = np.shape(occupied)
    x, y, yaw = origin
    place = make(
        "geometry_msgs/msg/Pose", position=make("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=np.sin(0.5 * yaw),
                         w=np.cos(0.5 * yaw)),
    )
    return make(
        FLOOR, header=header(stamp), info=make(
            "nav_msgs/msg/MapMetaData", map_load_time=header(stamp).stamp, resolution=resolution,
            width=width, height=height, origin=place,
        ),
        data=100 * np.ravel(occupied).astype(np.int8),
    )


def walled_messages(least: float) -> Iterator[Entry]:
    """Yield the run of `rolling_messages`, from x = 0 to 0.8 m in 4 s, on a floor with a wall.

    Its controller reports the floor before the run, and 0.25 m as the clearance of its plan after
    1 s. The floor is 4 m wide, in cells of 0.1 m, turned by a quarter about (2, -2); the wall
    stands across the way with `least` [m] between it and the sphere in its last place.
    """
    occupied = np.zeros((40, 40), dtype=bool)
    # Rows go towards -x from 2 m on, and the front of the sphere comes to 1.1 m.
    occupied[round(10.0 * (2.0 - 1.1 - least)) - 1] = True
    yield "/controller/floor", FLOOR, 10**9, floor(10**9, occupied, 0.1, (2.0, -2.0, np.pi / 2))
    for entry in rolling_messages():
        yield entry
        if entry[2] == 2 * 10**9:
            found = status(time_s=2, clearance_m=0.25)
            yield "/controller/status", STATUS, entry[2], found


def rolling_messages(length: float = 4.0, plan: str = "") -> Iterator[Entry]:
    """Yield a sphere that rolls at 0.2 m/s in x for a time [s].

    Its controller reports a solve whose plan has this status, if it is given.
    """
    for i in range(round(length / 0.02) + 1):
        stamp, x = 10**9 + i * 20_000_000, 0.004 * i
        turn = np.cos(0.5 * x / 0.3), 0.0, np.sin(0.5 * x / 0.3), 0.0
        yield "/pose", POSE, stamp, pose(stamp, (x, 0.0, *turn))
    if plan:
        solve = status(plan=plan, solve_time_s=0.01, time_s=1)
        yield "/controller/status", STATUS, 10**9, solve


def estimated(entries: Iterable[Entry], delay: int = 0) -> Iterator[Entry]:
    """Yield a run with odometry, whose poses are the true ones of a simulator.

    Each second pose has an estimate, logged after a delay [ns]. It is 3 mm and 4 mm off in x and
    y, and turned about the vertical too far by a hundredth of a radian a second, from time 0 on.
    """
    number = 0
    for entry in entries:
        topic, kind, log, message = entry
        if topic.rpartition("/")[2] != "pose":
            yield entry
            continue
        yield f"{topic.removesuffix('pose')}ground_truth/pose", kind, log, message
        number += 1
        if number % 2:
            at, turn = message.pose.position, message.pose.orientation
            half = 0.5 * 0.01 * log / 1e9
            q = rotation.product(np.array((np.cos(half), 0.0, 0.0, np.sin(half))),
                                 np.array((turn.w, turn.x, turn.y, turn.z)))
            yield topic, kind, log + delay, pose(log, (at.x + 0.003, at.y + 0.004, *q))


def changed(entry: Entry, *, log: int | None = None, stamp: int | None = None,
            edit: Callable[[Any], None] = lambda message: None) -> Entry:
    """Return an entry with another log time or stamp [ns], or an edited copy of its message."""
    topic, kind, time, message = entry
    message = deepcopy(message)
    if stamp is not None:
        message.header.stamp = header(stamp).stamp
    edit(message)
    return topic, kind, time if log is None else log, message


def goal_at(x: float, time: float) -> Entry:
    """Return a goal at x [m] that the controller accepts at a time of the run [s]."""
    stamp = START + round(time * 1e9)
    return "/controller/active_goal", POSE, stamp, pose(stamp, (x, 0, 1, 0, 0, 0))


def demand(goal: Entry, orientation: str) -> Entry:
    """Return the status that says what a goal of `goal_at` demands of the orientation."""
    stamp = goal[3].header.stamp
    named = f"{stamp.sec}.{stamp.nanosec:09d}"
    values = {"active_goal_stamp": named, "goal_orientation": orientation}
    return "/controller/status", STATUS, goal[2], status(**values)


def in_order(*entries: Entry) -> list[Entry]:
    return sorted(entries, key=lambda entry: entry[2])


def without(entries: Iterable[Entry], *endings: str) -> list[Entry]:
    """Return the entries of topics without these endings."""
    return [entry for entry in entries if not entry[0].endswith(endings)]


def write_own(folder: Path, entries: Iterable[Entry], custom: Mapping[str, str] = {}) -> Path:
    """Write a bag of the recorder, with custom data."""
    writer = BagWriter(folder)
    writer.custom_data.update(custom)
    for topic, kind, stamp, message in entries:
        writer.add_topic(topic, kind)
        writer.write(topic, stamp, bytes(STORE.serialize_cdr(message, kind)))
    writer.close()
    return folder


def write_rosbag2(
    folder: Path, entries: Iterable[Entry], kind: str = "mcap", compression: str = "",
    parts: int = 1, custom: dict[str, str] | None = None,
) -> Path:
    """Write a bag as ``ros2 bag record`` does.

    The storage files are called folder_0, folder_1, …, with the suffix ``.zstd`` if files are
    compressed; metadata.yaml lists them in order, and the mode of compression in capitals.
    """
    entries, yaml, descriptions, names = list(entries), YAML(typ="safe"), [], []
    folder.mkdir()
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
            for topic, msgtype, stamp, message in entries[share]:
                data = STORE.serialize_cdr(message, msgtype)
                writer.write(connections[topic], stamp, data)
        described = yaml.load((part / "metadata.yaml").read_text())
        descriptions.append(described["rosbag2_bagfile_information"])
        file = next(file for file in part.iterdir() if file.suffix in (".mcap", ".db3"))
        name, data = f"{folder.name}_{i}{file.suffix}", file.read_bytes()
        if compression == "file":
            name, data = f"{name}.zstd", zstandard.compress(data)
        names.append(name)
        (folder / name).write_bytes(data)
    stamps = [entry[2] for entry in entries]
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
        yaml.dump({"rosbag2_bagfile_information": about}, stream)
    return folder


def on_the_system_clock(entries: Iterable[Entry]) -> list[Entry]:
    """Return entries with the log times of a recorder without simulated time.

    Log times are as irregular as on a busy machine. Simulated time is paused before the run, while
    the first pose is repeated.
    """
    entries, rng = list(entries), np.random.default_rng(7)
    first = next(entry for entry in entries if entry[0].endswith("/pose"))
    steps = [0.1] * 30 + list(rng.exponential(3e-4, len(entries)))
    logs = 1_800_000_000_000_000_000 + np.round(np.cumsum(steps) * 1e9).astype(np.int64)
    order = [*[first] * 30, *entries]
    return [(*entry[:2], int(log), entry[3]) for entry, log in zip(order, logs, strict=True)]
