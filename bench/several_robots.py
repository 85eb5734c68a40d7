# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs of several robots in one domain at the same time, each in a namespace of its own.

    python bench/several_robots.py --robots 3 --goals 10

The first robot has no namespace. Each robot gets its next goal as soon as it has reached the last
one, independently of the others.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
from node_runs import PATIENCE, machine, write_json
from rclpy.executors import SingleThreadedExecutor

from sphere_nmpc.model.state import Vector
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.goal_run import GoalRunner
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.scenario.scenarios import draw_scenarios

_LONGEST = 60.0
"""Wall time for one goal [s]."""
_NAMES = ("", "second", "third", "fourth", "fifth")


class Robot:
    """The goals of one robot, of which the next is sent when the last was reached."""

    def __init__(
        self, executor: SingleThreadedExecutor, name: str, goals: Sequence[Vector]
    ) -> None:
        self.name = name or "(no namespace)"
        self._goals = list(goals)
        self.took: list[float] = []
        """Wall time to each goal that was reached [s]."""
        self.done = False
        """Whether all goals were reached, or one was given up."""
        self._sent_at: float | None = None
        node = rclpy.create_node("fleet", namespace=name)
        executor.add_node(node)
        self._runner = GoalRunner(node, lambda: executor.spin_once(timeout_sec=0.05))

    def prepare(self) -> None:
        """Wait for the robot's nodes."""
        self._runner.prepare(PATIENCE)

    def advance(self) -> None:
        """Send the next goal, if the last one was reached."""
        if self.done:
            return
        now, run = time.monotonic(), self._runner.run
        if self._sent_at is not None and run is not None:
            if run.settled_at() is None:
                self.done = now > self._sent_at + _LONGEST
                return
            self.took.append(now - self._sent_at)
        if self._goals:
            self._sent_at = now
            self._runner.send(self._goals.pop(0), PATIENCE)
        else:
            self.done = True


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
    with own_domain(), tempfile.TemporaryDirectory() as folder, ProcessSet(Path(folder)) as nodes:
        for name in names:
            place = ["-r", f"__ns:=/{name}"] if name else []
            nodes.start("simulator", ["--ros-args", *place], name=f"simulator {name}")
            follow = ["--ros-args", "-p", "use_sim_time:=true", *place]
            nodes.start("controller", follow, name=f"controller {name}")
        rclpy.init()
        try:
            executor = SingleThreadedExecutor()
            robots = [
                Robot(executor, name, [s.goal for s in scenarios[i :: options.robots]])
                for i, name in enumerate(names)
            ]
            for robot in robots:
                robot.prepare()
            while not all(robot.done for robot in robots):
                executor.spin_once(timeout_sec=0.05)
                nodes.check()
                for robot in robots:
                    robot.advance()
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
