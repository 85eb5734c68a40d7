# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading of bags, of the recorder or of ``ros2 bag record``, as the arrays of a `Run`.

Messages are accessed by attribute as ``rosbags`` decodes them, so that a bag can be read where no
ROS is installed; ``sphere_nmpc.ros.messages`` is the counterpart for ROS messages.
"""

from pathlib import Path

from sphere_sim.output.printable_path import printable
from sphere_sim.recording.bag_files import storage_name
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.goals import read_goals
from sphere_sim.recording.messages import Messages, read_messages
from sphere_sim.recording.momentum import read_momentum
from sphere_sim.recording.poses import read_poses
from sphere_sim.recording.recorded_parameters import recorded_robot
from sphere_sim.recording.rotors import read_joint_states, read_plans
from sphere_sim.recording.run import Run, without_sign_jumps
from sphere_sim.recording.solves import read_solves

_POSE = "geometry_msgs/msg/PoseStamped"
_TYPES = {
    "pose": _POSE,
    "joint_states": "sensor_msgs/msg/JointState",
    "rotor_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "goal_pose": _POSE,
    "active_goal": _POSE,
    "status": "diagnostic_msgs/msg/DiagnosticStatus",
    "pushed": "geometry_msgs/msg/Vector3Stamped",
}
"""Message types of the topics that a run consists of."""


def read_run(path: Path, namespace: str | None = None, name: str | None = None) -> Run:
    """Read the run of one robot from a bag.

    Parameters
    ----------
    path : Path
        Folder or file, see `read_messages`.
    namespace : str, optional
        Namespace of the robot, as in ``/left``; needed only if the bag has several robots.
    name : str, optional
        Name of the run in legends; that of the bag by default.

    Raises
    ------
    BagError
        If there is no bag, it is empty or of another robot, it has several robots and no
        namespace is given, or the files are of several bags.
    """
    messages = read_messages(path, _is_used)
    robot = _select_robot(messages, namespace)
    clock, times, states = read_poses(messages, robot)
    joint_times, speeds, torques = read_joint_states(messages, robot, clock)
    goal_times, goals = read_goals(messages, robot, clock, times)
    solves = read_solves(messages, robot, clock)
    plans = read_plans(messages, robot, clock)
    parameters = recorded_robot(messages.custom_data, f"{robot}/controller")
    return Run(
        name=printable(name or Path(storage_name(path)).stem),
        path=path,
        origin=1e-9 * clock.origin,
        times=times,
        states=without_sign_jumps(states),
        joint_times=joint_times,
        rotor_speeds=speeds,
        rotor_torques=torques,
        goal_times=goal_times,
        goals=goals,
        plans=plans,
        solves=solves,
        momentum=read_momentum(messages, robot, clock, parameters),
        robot=parameters,
        custom_data=messages.custom_data,
        notes=tuple(messages.notes),
    )


def _is_used(topic: str, msgtype: str) -> bool:
    return _TYPES.get(topic.rpartition("/")[2]) == msgtype


def _select_robot(messages: Messages, given: str | None) -> str:
    """Return the namespace of the robot without a slash at its end."""
    found = sorted(
        topic.removesuffix("/pose")
        for topic, msgtype in messages.types.items()
        if topic.endswith("/pose") and msgtype == _POSE
    )
    if given is not None:
        robot = "/" + given.strip("/") if given.strip("/") else ""
        if robot in found:
            return robot
        names = ", ".join(name or "/" for name in found) or "none"
        raise BagError(messages.path, f"no robot in namespace '{given}'; it has: {names}")
    if not found:
        raise BagError(messages.path, _no_robot(messages))
    if len(found) > 1:
        names = ", ".join(name or "/" for name in found)
        raise BagError(
            messages.path, f"holds several robots, choose one by its namespace: {names}"
        )
    return found[0]


def _no_robot(messages: Messages) -> str:
    """Return why a bag has no robot of this kind."""
    reason = f"no topic 'pose' of type {_POSE}"
    if messages.truncated:
        return messages.incomplete(reason)
    if not messages.types:
        return "is empty: it has no topic at all"
    return f"{reason}, so a bag of another robot; has: {', '.join(sorted(messages.types))}"
