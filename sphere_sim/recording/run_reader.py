# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""From a bag to the arrays of a `Run`, for bags of the own recorder and of ``ros2 bag record``.

Messages are read by attribute as the type store of ``rosbags`` decodes them, so that a bag can be
looked at where no ROS is installed; this is the counterpart of ``sphere_nmpc.ros.conversions``.
"""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidInputError, InvalidParameterError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, QUATERNION_NORM_TOLERANCE, Vector
from sphere_sim.printable_path import printable
from sphere_sim.recording.bag_clock import BagClock, longest_run
from sphere_sim.recording.bag_files import storage_name
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.goals import read_goals
from sphere_sim.recording.messages import Messages, read_messages
from sphere_sim.recording.run import Run, without_sign_jumps
from sphere_sim.recording.solves import SOLVE_TOPICS, read_solves
from sphere_sim.recording.stamps import stamp_of, state_of

POSE = "geometry_msgs/msg/PoseStamped"
JOINTS = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ROTORS = ("rotor_1_joint", "rotor_2_joint")
PARAMETERS_PREFIX = "parameters:"
"""Custom data under this prefix and a node's full name hold its parameters as JSON."""

_EXPECTED = {
    "pose": POSE,
    "joint_states": JOINTS,
    "rotor_trajectory": TRAJECTORY,
    "goal_pose": POSE,
    "active_goal": POSE,
    **SOLVE_TOPICS,
}
_NANO = 1e-9


def read_run(path: Path, namespace: str | None = None, name: str | None = None) -> Run:
    """Read a bag.

    Parameters
    ----------
    path : Path
        Folder or file, see `read_messages`.
    namespace : str, optional
        Of the robot, as in ``/left``; may be left out where the bag has one robot only.
    name : str, optional
        For legends; the name of the bag by default.

    Returns
    -------
    Run

    Raises
    ------
    BagError
        If there is no bag, it is empty, it holds another robot, which robot is not clear, or the
        files are of several bags.
    """
    messages = read_messages(path, _wanted)
    robot = _namespace(path, messages, namespace)
    notes = messages.notes
    clock, times, states = _states(path, messages, f"{robot}/pose")
    joint_times, speeds, torques = _joints(path, messages, robot, clock)
    goal_times, goals = read_goals(messages.taken, robot, clock, float(times[-1]), notes)
    solves = read_solves(messages.taken, robot, clock)
    if not solves.times.size:
        notes.append("nothing tells how the controller solved; no solve times")
    plans = _plans(messages, robot, clock)
    parameters = _parameters(messages.custom_data, f"{robot}/controller")
    return Run(
        name=printable(name or Path(storage_name(path)).stem),
        path=path,
        origin=clock.origin * _NANO,
        times=times,
        states=without_sign_jumps(states),
        joint_times=joint_times,
        rotor_speeds=speeds,
        rotor_torques=torques,
        goal_times=goal_times,
        goals=goals,
        plans=plans,
        solves=solves,
        robot=_robot(parameters),
        custom_data=messages.custom_data,
        notes=tuple(notes),
    )


def _wanted(topic: str, msgtype: str) -> bool:
    return _EXPECTED.get(topic.rpartition("/")[2]) == msgtype


def _namespace(path: Path, messages: Messages, given: str | None) -> str:
    """Return the namespace of the robot without a slash at its end."""
    found = sorted(
        topic.removesuffix("/pose")
        for topic, msgtype in messages.types.items()
        if topic.endswith("/pose") and msgtype == POSE
    )
    if given is not None:
        robot = "/" + given.strip("/") if given.strip("/") else ""
        if robot in found:
            return robot
        there = ", ".join(name or "/" for name in found) or "none"
        raise BagError(path, f"no robot in namespace '{given}'; it has: {there}")
    if not found:
        topics = ", ".join(sorted(messages.types))
        if messages.broken:
            raise BagError(path, _so_far(messages, f"no topic 'pose' of type {POSE}"))
        if not topics:
            raise BagError(path, "is empty: it has no topic at all")
        raise BagError(path, f"no topic 'pose' of type {POSE}, so another robot's; has: {topics}")
    if len(found) > 1:
        names = ", ".join(name or "/" for name in found)
        raise BagError(path, f"holds several robots, choose one by its namespace: {names}")
    return found[0]


def _so_far(messages: Messages, lacks: str) -> str:
    """Say what a bag lacks of which there may have been more."""
    return f"{lacks} in what can be read of it: {'; '.join(messages.notes)}"


def _states(path: Path, messages: Messages, topic: str) -> tuple[BagClock, Vector, Vector]:
    """Return the run's clock, and times [s] and states (n, 6) of its poses in order of stamp."""
    entries = messages.taken.get(topic, [])
    if not entries:
        lacks = f"no message on {topic}"
        raise BagError(path, _so_far(messages, lacks) if messages.notes else f"is empty: {lacks}")
    states = np.array([state_of(message) for _, message in entries])
    norms = np.linalg.norm(states[:, QUATERNION], axis=1)
    sound = np.abs(norms - 1.0) <= QUATERNION_NORM_TOLERANCE
    sound &= np.all(np.isfinite(states), axis=1)
    if not np.any(sound):
        raise BagError(path, f"no message on {topic} holds a pose")
    if not np.all(sound):
        told = f"{topic}: {int(np.sum(~sound))} poses are no poses and were left out"
        messages.notes.append(told)
    pairs = [
        (log, stamp_of(it)) for (log, it), use in zip(entries, sound, strict=True) if use
    ]
    run = longest_run([stamp for _, stamp in pairs])
    received, stamps = zip(*pairs[run], strict=True)
    if len(stamps) < len(pairs):
        told = f"{topic}: time goes back, so the bag holds several runs; only the longest is taken"
        messages.notes.append(f"{told}, {len(stamps)} of {len(pairs)} poses")
        following = [log for log, _ in pairs[run.stop :]]
        _leave_out_others(messages, received[0], following[0] if following else None)
    clock = BagClock(received, stamps)
    states = (states[sound] / np.where(np.arange(6) < 2, 1.0, norms[sound, None]))[run]
    # While simulated time stands still, the simulator repeats the instant it stands at.
    times, first = np.unique([clock.time(stamp) for stamp in stamps], return_index=True)
    return clock, times, states[first]


def _leave_out_others(messages: Messages, first: int, following: int | None) -> None:
    """Leave out what was logged in other runs; a goal from before may still be in force."""
    for topic, entries in messages.taken.items():
        is_goal = topic.endswith(("/goal_pose", "/active_goal"))
        messages.taken[topic] = [
            (log, message) for log, message in entries
            if (is_goal or log >= first) and (following is None or log < following)
        ]


def _joints(
    path: Path, messages: Messages, robot: str, clock: BagClock
) -> tuple[Vector, Vector, Vector]:
    """Return times [s], rotor speeds and torques (m, 2)."""
    topic = f"{robot}/joint_states"
    entries = messages.taken.get(topic, [])
    rows = []
    for entry in entries:
        message = entry[1]
        names = list(message.name)
        if not set(ROTORS) <= set(names):
            # Grippers and other joints may share the topic.
            continue
        order = [names.index(name) for name in ROTORS]
        rows.append([
            clock.time(stamp_of(message)),
            *_pick(message.velocity, order),
            *_pick(message.effort, order),
        ])
    if entries and not rows:
        names = list(entries[0][1].name)
        raise BagError(path, f"{topic} names {names}, not {list(ROTORS)}: a bag of another robot")
    if not rows:
        messages.notes.append(f"{topic} is missing; no rotor speeds and torques")
    table = np.array(rows, dtype=float).reshape(-1, 5)
    times, first = np.unique(table[:, 0], return_index=True)
    return times, table[first, 1:3], table[first, 3:5]


def _pick(values: Sequence[float], order: Sequence[int]) -> list[float]:
    return [float(values[i]) if i < len(values) else float("nan") for i in order]


def _plans(messages: Messages, robot: str, clock: BagClock) -> tuple[FirstOrderHold, ...]:
    topic = f"{robot}/rotor_trajectory"
    entries = messages.taken.get(topic, [])
    if not entries:
        messages.notes.append(f"{topic} is missing; no plans")
    plans = []
    for received, message in entries:
        names = list(message.joint_names)
        if set(names) != set(ROTORS):
            continue
        start = clock.told(stamp_of(message), received, kept=True)
        order = [names.index(name) for name in ROTORS]
        after = [p.time_from_start.sec + p.time_from_start.nanosec * _NANO for p in message.points]
        speeds = [_pick(point.velocities, order) for point in message.points]
        try:
            plans.append(FirstOrderHold(start + np.array(after), np.array(speeds)))
        except InvalidInputError:
            continue  # refused by the simulator as well
    if len(plans) < len(entries):
        count = len(entries) - len(plans)
        messages.notes.append(f"{topic}: {count} trajectories are no plans and were left out")
    return tuple(plans)


def _parameters(custom_data: dict[str, str], node: str) -> dict[str, Any]:
    """Return the recorded parameters of a node; empty where the bag has none."""
    try:
        values = json.loads(custom_data.get(f"{PARAMETERS_PREFIX}{node}", "{}"))
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}


def _robot(parameters: dict[str, Any]) -> RobotParameters:
    """Return the robot as a node's parameters ``robot.*`` tell it."""
    names = {entry.name for entry in dataclasses.fields(RobotParameters)}
    given = {
        key.removeprefix("robot."): value
        for key, value in parameters.items()
        if key.startswith("robot.")
    }
    try:
        return RobotParameters(**{key: value for key, value in given.items() if key in names})
    except InvalidParameterError:
        return RobotParameters()
