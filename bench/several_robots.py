# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Several robots in one domain, a namespace each: do they reach their goals at the same time?

    python bench/several_robots.py --robots 3 --goals 10

The first robot has no namespace. Every robot gets its goals one after another, a new one as soon
as ``controller/at_goal`` tells that it has arrived; nobody waits for the others.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped
from node_runs import PATIENCE, machine, write_json
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool

from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.conversions import pose_to_ros
from sphere_sim.ros.session.children import Children
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.scenario.scenarios import draw_scenarios

_RADIUS = 0.3
_LONGEST = 60.0
"""Wall time for one goal [s]."""
_NAMES = ("", "second", "third", "fourth", "fifth")


class Robot:
    """One robot's goals: sends the next one when the last is reached."""

    def __init__(self, node: Node, name: str, goals: Sequence[Vector]) -> None:
        self.name = name or "(no namespace)"
        self._goals = list(goals)
        self.took: list[float] = []
        """Wall time to each goal that was reached [s]."""
        self._sent_at = 0.0
        prefix = f"/{name}" if name else ""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(PoseStamped, f"{prefix}/goal_pose", 1)
        node.create_subscription(Bool, f"{prefix}/controller/at_goal", self._told, latched)
        self._waits = False

    @property
    def ready(self) -> bool:
        """Whether the controller listens."""
        return self._publisher.get_subscription_count() > 0

    @property
    def done(self) -> bool:
        """Whether there is no goal left, or the last one takes too long."""
        late = self._waits and time.monotonic() > self._sent_at + _LONGEST
        return late or (not self._goals and not self._waits)

    def send(self) -> None:
        """Send the next goal, if there is one."""
        self._waits = bool(self._goals)
        if self._goals:
            self._sent_at = time.monotonic()
            self._publisher.publish(pose_to_ros(self._goals.pop(0), 0, _RADIUS))


    def _told(self, message: Bool) -> None:
        # False comes with each new goal, before true can.
        if message.data and self._waits:
            self.took.append(time.monotonic() - self._sent_at)
            self.send()


def main() -> int:
    """Run the robots, print a table, and return 0 if all arrived and no clock jumped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=3, choices=range(1, len(_NAMES) + 1))
    parser.add_argument("--goals", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file for the results")
    options = parser.parse_args()
    about, names = machine(), _NAMES[: options.robots]
    scenarios = draw_scenarios(options.robots * options.goals, options.seed)
    with own_domain(), tempfile.TemporaryDirectory() as folder, Children(
        Path(folder)
    ) as children:
        for name in names:
            place = ["-r", f"__ns:=/{name}"] if name else []
            children.start("simulator", ["--ros-args", *place], name=f"simulator {name}")
            follow = ["--ros-args", "-p", "use_sim_time:=true", *place]
            children.start("controller", follow, name=f"controller {name}")
        rclpy.init()
        try:
            node = rclpy.create_node("fleet")
            robots = [
                Robot(node, name, [s.goal for s in scenarios[i :: options.robots]])
                for i, name in enumerate(names)
            ]
            end = time.monotonic() + PATIENCE
            while not all(robot.ready for robot in robots) and time.monotonic() < end:
                rclpy.spin_once(node, timeout_sec=0.1)
            for robot in robots:
                robot.send()
            while not all(robot.done for robot in robots):
                rclpy.spin_once(node, timeout_sec=0.1)
                children.check()
        finally:
            rclpy.try_shutdown()
        warnings = [
            line for log in sorted(Path(folder).glob("*.log"))
            for line in log.read_text(errors="replace").splitlines() if "[WARN]" in line
        ]
    print(f"{about['date']}, load {about['load_average']}")
    for robot in robots:
        longest = max(robot.took, default=float("nan"))
        reached = f"{len(robot.took)} of {options.goals} goals"
        print(f"{robot.name:15s} {reached}, longest {longest:.1f} s")
    print(*warnings or ["no warning of any node"], sep="\n")
    took = {robot.name: robot.took for robot in robots}
    write_json(options, {"machine": about, "reached_s": took, "warnings": warnings})
    complete = all(len(robot.took) == options.goals for robot in robots)
    jumped = any("clock jumped" in line or "other publisher" in line for line in warnings)
    return 0 if complete and not jumped else 1


if __name__ == "__main__":
    raise SystemExit(main())
