# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Delivery of goals sent with ``ros2 topic pub``, with different other nodes running.

    python bench/goals_arrive.py --goals 20

Each goal is sent by a process of its own (topic_pub.py) as with ``--once``, and as with ``-t 3``,
which the documents print. Discovery is ROS's own, or with --loopback that of the package. The
controller runs with the simulator alone, then with recorder and viewer, then also with another
subscriber of goal_pose, as from ``ros2 topic echo``.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped
from node_runs import PATIENCE, machine, write_json
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.ros.session.serving import serve_until

_SENDER = Path(__file__).with_name("topic_pub.py")
_OTHERS = {"alone": (), "recorder and viewer": ("recorder", "viewer")}
_ECHO = "recorder, viewer and an echo"
_FORMS = {"--once": 1, "-t 3": 3}


def arrived(node: Node, active: list[float], times: int, number: int) -> bool:
    """Send a goal that is recognised by its number; return whether it came into force."""
    goal = 0.01 * (number + 1)
    subprocess.run([sys.executable, _SENDER, str(goal), str(times)], check=True)
    return serve_until(
        lambda: rclpy.spin_once(node, timeout_sec=0.05), lambda: goal in active, 1.0
    )


def trial(others: str, goals: int, loopback: bool) -> dict[str, int]:
    """Return how many of `goals` arrived, by the form in which they were sent."""
    with own_domain(loopback), tempfile.TemporaryDirectory() as folder, ProcessSet(
        Path(folder)
    ) as nodes:
        nodes.start("simulator")
        nodes.start("controller", ["--ros-args", "-p", "use_sim_time:=true"])
        for verb in _OTHERS.get(others, ("recorder", "viewer")):
            own = ["--port", "0"] if verb == "viewer" else []
            bag = ["-p", f"output:={folder}/bag"] if verb == "recorder" else []
            nodes.start(verb, [*own, "--ros-args", *bag])
        rclpy.init()
        try:
            node = rclpy.create_node("observer")
            active: list[float] = []
            latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)

            def note(goal: PoseStamped) -> None:
                active.append(goal.pose.position.x)

            node.create_subscription(PoseStamped, "controller/active_goal", note, latched)
            if others == _ECHO:
                node.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
            wanted = 2 + len(_OTHERS.get(others, ("recorder", "viewer")))
            serve_until(
                lambda: rclpy.spin_once(node, timeout_sec=0.1),
                lambda: len(node.get_node_names()) > wanted, PATIENCE,
            )
            nodes.check()
            counts: dict[str, int] = {}
            for form, times in _FORMS.items():
                first = len(counts) * goals
                numbers = range(first, first + goals)
                counts[form] = sum(arrived(node, active, times, n) for n in numbers)
            return counts
        finally:
            rclpy.try_shutdown()


def main() -> int:
    """Make the trials, print a table, and return 0 if every goal that should arrive did."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=20, help="of each kind")
    parser.add_argument("--loopback", action="store_true", help="stay on the loopback")
    parser.add_argument("--json", type=Path, help="file for the results")
    options = parser.parse_args()
    about, rows = machine(), {}
    print(f"{about['date']}, load {about['load_average']}")
    for others in (*_OTHERS, _ECHO):
        rows[others] = trial(others, options.goals, options.loopback)
        counts = ", ".join(f"{form}: {n} of {options.goals}" for form, n in rows[others].items())
        print(f"{others:28s} {counts}", flush=True)
    write_json(options, {"machine": about, "goals": options.goals, "arrived": rows})
    # With another subscriber of goal_pose, --once reaches the one that is matched first only.
    expected = [n for others, row in rows.items() for form, n in row.items()
                if others != _ECHO or form != "--once"]
    return 0 if min(expected) == options.goals else 1


if __name__ == "__main__":
    raise SystemExit(main())
