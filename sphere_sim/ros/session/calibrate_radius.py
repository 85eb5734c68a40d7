# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command ``calibrate_radius``: the radius of the shell from a way that was measured."""

import argparse
import select
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.estimation.rolled_radius import rolled_radius
from sphere_nmpc.foreign_text import Description
from sphere_nmpc.ros import cdr
from sphere_sim.output.arguments import positive

_TOPIC = "pose"
_WAIT = 0.05
"""Time between two looks for the end of the way [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the radius; return 0, or 2 after one line where the way is not fit for it."""
    given = parse(sys.argv[1:] if arguments is None else arguments)
    seen = _recorded(given.from_bag) if given.from_bag else _live(given.ros, given.distance)
    # A simulator whose time stands still repeats its messages.
    poses = [pose for i, pose in enumerate(seen) if not i or pose.stamp > seen[i - 1].stamp]
    if not poses:
        raise InvalidInputError(_TOPIC, Description("no message"), "those of the odometry")
    times = np.array([cdr.seconds(pose.stamp, poses[0].stamp) for pose in poses])
    numbers = np.array([pose.numbers[:3] for pose in poses])
    before = float(numbers[0, 2])  # the height of the centre
    radius, rolled = rolled_radius(times, numbers[:, :2], before, given.distance)
    deviation = given.tape * before / rolled
    print(
        f"{given.distance:g} m measured, {rolled:.4f} m estimated with {before:.5g} m\n"
        f"robot.shell_radius: {radius:.5f}    # +- {deviation:.5f} m by +- {given.tape:g} m of "
        "the measured way"
    )
    return 0


def _live(words: Sequence[str], distance: float) -> list[cdr.Pose]:
    """Return the poses from now until Enter is pressed."""
    import rclpy
    from geometry_msgs.msg import PoseStamped

    from sphere_nmpc.ros.guarded_node import GuardedNode, spin_for
    from sphere_nmpc.ros.startup import start_ros

    start_ros(words)
    node, seen = GuardedNode("calibrate_radius"), list[cdr.Pose]()
    node.create_subscription(
        PoseStamped, _TOPIC, lambda raw: seen.append(cdr.read(raw, cdr.Pose)), 1000, raw=True
    )
    try:
        executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(node)
        while not seen:
            spin_for(executor, _WAIT)
        print(f"roll {distance:g} m along a straight line; Enter when the sphere rests again",
              flush=True)
        while not select.select([sys.stdin], [], [], 0.0)[0]:
            spin_for(executor, _WAIT)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return seen


def _recorded(bag: Path) -> list[cdr.Pose]:
    """Return the poses of a bag."""
    from sphere_sim.recording.messages import read_messages

    decoded = read_messages(bag, lambda topic, kind: (
        topic.rpartition("/")[2] == _TOPIC and "ground_truth" not in topic
        and kind == cdr.TYPES[cdr.Pose]
    )).decoded
    if len(decoded) > 1:
        raise InvalidInputError("topics of poses", sorted(decoded), "one: a bag of one robot")
    return [pose for poses in decoded.values() for _, pose in poses]


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the arguments; those of ROS as `ros`."""
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc calibrate_radius",
        description="Find the radius of the shell: let the sphere roll along a straight line, "
        "with poses of an odometry that gets no pose_fix, and measure how far it came.",
    )
    parser.add_argument("distance", type=positive, metavar="METRES", help="way that was measured")
    parser.add_argument("--tape", type=positive, default=1e-3, metavar="METRES",
                        help="standard deviation of that (default: %(default)g)")
    parser.add_argument("--from-bag", type=Path, metavar="BAG",
                        help="take the poses of a bag, from rest to rest, not those of now")
    words = list(arguments)
    at = words.index("--ros-args") if "--ros-args" in words else len(words)
    given = parser.parse_args(words[:at])
    given.ros = words[at:]
    return given
