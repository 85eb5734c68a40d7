# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs to goals with simulator and controller on two hosts, over a link that loses packets.

    sudo python bench/two_hosts.py --loss 0 1 5 20 --goals 6 --json out/two_hosts.json

The hosts are network namespaces, see `lossy_link`. Discovery is limited to the machine itself and
the other host, by address; shared memory, which would bypass the link, is switched off.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from lossy_link import ADDRESSES, LinkError, Quality, lossy_link
from rich.console import Console
from rich.table import Table

from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.ros.faults.goal_actions import random_goal
from sphere_sim.ros.session.goal_run import GoalRunner
from sphere_sim.ros.session.process_set import ProcessSet

DEADLINE = 60.0
"""Time to a goal after which it is given up [s]."""
REACH = 1.5
"""Largest |x| and |y| of a goal [m]."""
_PATIENCE = 90.0
"""How long the nodes may take to find each other, and to confirm a goal [s]."""
_REPEAT = 3.0
"""Wall time after which an unconfirmed goal is sent again [s]."""
_DOMAIN = "65"


def main() -> int:
    """Run with each quality of the link and print how many goals were reached."""
    given = _parse()
    if given.inside:
        print(json.dumps(_inside(given)))
        return 0
    results = []
    try:
        for loss in given.loss:
            quality = Quality(1e-3 * given.delay, 1e-3 * given.jitter, 1e-2 * loss)
            results.append({"loss_percent": loss, **_over(quality, given)})
            print(results[-1], flush=True)
    except (LinkError, PermissionError) as error:
        print(f"two hosts: {error}; is this Linux, and you root?", file=sys.stderr)
        return 1
    _print(results)
    if given.json:
        given.json.parent.mkdir(parents=True, exist_ok=True)
        given.json.write_text(json.dumps({"two_hosts": results}, indent=2) + "\n")
    return 0 if all(row["reached"] == row["goals"] for row in results) else 1


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--loss", type=float, nargs="+", default=[0.0, 1.0, 5.0, 20.0],
                        help="packets lost in either direction [%%]")
    parser.add_argument("--delay", type=float, default=20.0, help="in either direction [ms]")
    parser.add_argument("--jitter", type=float, default=10.0, help="around it, either way [ms]")
    parser.add_argument("--goals", type=int, default=6, help="one after the other, for each loss")
    parser.add_argument("--seed", type=int, default=0, help="of the goals")
    parser.add_argument("--strategy", default="time_optimal")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--inside", metavar="OTHER", help=argparse.SUPPRESS)
    return parser.parse_args()


def _over(quality: Quality, given: argparse.Namespace) -> dict[str, object]:
    """Run this program again on the first of the two hosts, with the name of the second."""
    with lossy_link(quality) as link:
        here, there = link.hosts
        environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith(("ROS_A", "FAST"))},
            "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", _DOMAIN),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_STATIC_PEERS": ";".join(ADDRESSES),
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }
        own = ["--goals", str(given.goals), "--seed", str(given.seed),
               "--strategy", given.strategy, "--inside", there]
        done = subprocess.run(
            ["ip", "netns", "exec", here, sys.executable, __file__, *own],
            env=environment, stdout=subprocess.PIPE, text=True, check=False,
        )
        if done.returncode:
            raise LinkError(f"the run ended with exit code {done.returncode}")
        return {"by": link.means, **json.loads(done.stdout.splitlines()[-1])}


def _inside(given: argparse.Namespace) -> dict[str, object]:
    """Start the simulator here and the controller there, and send goals from here."""
    with tempfile.TemporaryDirectory() as logs, ProcessSet(Path(logs)) as nodes:
        nodes.start("simulator", ["--ros-args", "-p", "pose_rate:=50.0"])
        nodes.start(
            "controller",
            ["--ros-args", "-p", "use_sim_time:=true", "-p", f"strategy:={given.strategy}"],
            within=["ip", "netns", "exec", given.inside],
        )
        rclpy.init(args=[])
        try:
            return _Goals(given.goals, given.seed).run()
        except SphereNmpcError:
            print(Path(logs, "controller.log").read_text(), file=sys.stderr)
            raise
        finally:
            rclpy.try_shutdown()


class _Goals:
    """Random goals, each of which is sent when the one before has been reached."""

    def __init__(self, number: int, seed: int) -> None:
        self._number = number
        self._rng = np.random.default_rng(seed)
        self._node = rclpy.create_node("two_hosts")
        self._status: dict[str, str] = {}
        self._ages: list[float] = []
        self._goals = GoalRunner(self._node, self._spin)
        self._node.create_subscription(
            DiagnosticStatus, "controller/status", self._take_status, 10
        )

    def run(self) -> dict[str, object]:
        self._goals.prepare(_PATIENCE)
        took = [
            self._goals.go(random_goal(self._rng, REACH), DEADLINE, _PATIENCE, _REPEAT)
            for _ in range(self._number)
        ]
        reached = [time for time in took if time is not None]
        return {
            "goals": self._number,
            "reached": len(reached),
            "settle_s_median": round(statistics.median(reached), 2) if reached else None,
            "settle_s_longest": round(max(reached), 2) if reached else None,
            "pose_age_s_mean": round(statistics.fmean(self._ages), 3),
            "late_poses": int(self._status["late_poses"]),
            "missed_ticks": int(self._status["missed_ticks"]),
        }

    def _spin(self) -> None:
        rclpy.spin_once(self._node, timeout_sec=0.05)

    def _take_status(self, message: DiagnosticStatus) -> None:
        self._status = {pair.key: pair.value for pair in message.values}
        age = float(self._status["pose_age_s"])
        if math.isfinite(age):
            self._ages.append(age)


def _print(results: list[dict[str, object]]) -> None:
    table = Table(*results[0])
    for row in results:
        table.add_row(*(str(value) for value in row.values()))
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main())
