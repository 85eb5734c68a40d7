# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller on two hosts, and how goals are reached over a link that loses packets.

    sudo python bench/two_hosts.py --loss 0 1 5 20 --goals 6 --json out/two_hosts.json

The hosts are network namespaces, see `lossy_link`. Discovery is limited to the machine itself and
the other host, by address; shared memory, which would pass by the link, is switched off.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from lossy_link import ADDRESSES, LinkError, Quality, lossy_link
from rich.console import Console
from rich.table import Table

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.ros.conversions import pose_from_ros, seconds, stamp_from_ros
from sphere_sim.ros.session.children import Children
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender

SETTLED = 1e-2
STAYED = 1.0
"""How long the goal has to be held to count as reached [s]."""
DEADLINE = 60.0
"""Time to a goal after which it is given up [s]."""
REACH = 1.5
_PATIENCE = 90.0
_DOMAIN = "65"


def main() -> int:
    """Run the link's qualities one after the other and tell what became of the goals."""
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
    _tell(results)
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
    """Run this program again on the first of two hosts, which knows how to reach the second."""
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
    with tempfile.TemporaryDirectory() as logs, Children(Path(logs)) as children:
        children.start("simulator", ["--ros-args", "-p", "pose_rate:=50.0"])
        children.start(
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
    """Random goals, each sent when the one before has been reached."""

    def __init__(self, number: int, seed: int) -> None:
        self._number = number
        self._rng = np.random.default_rng(seed)
        self._node = rclpy.create_node("two_hosts")
        self._time = 0.0
        self._state: Vector | None = None
        self._status: dict[str, str] = {}
        self._ages: list[float] = []
        self._goals = GoalSender(self._node, self._spin)
        self._node.create_subscription(PoseStamped, "pose", self._take_pose, 10)
        self._node.create_subscription(
            DiagnosticStatus, "controller/status", self._take_status, 10
        )

    def run(self) -> dict[str, object]:
        self._goals.wait_for_controller(_PATIENCE)
        while self._state is None:
            self._spin()
        settled = [self._settling_time() for _ in range(self._number)]
        reached = [time for time in settled if math.isfinite(time)]
        return {
            "goals": self._number,
            "reached": len(reached),
            "settle_s_median": round(statistics.median(reached), 2) if reached else None,
            "settle_s_longest": round(max(reached), 2) if reached else None,
            "pose_age_s_mean": round(statistics.fmean(self._ages), 3),
            "late_poses": int(self._status["late_poses"]),
            "missed_ticks": int(self._status["missed_ticks"]),
        }

    def _settling_time(self) -> float:
        """Send a goal and return the simulated time to it [s]; inf if it is not reached."""
        turn = self._rng.normal(size=4)
        goal = np.concatenate((self._rng.uniform(-REACH, REACH, 2), turn / np.linalg.norm(turn)))
        sent, end = self._time, time.monotonic() + _PATIENCE
        while True:
            try:
                self._goals.send(goal, 0.3, 3.0)
                break
            except GoalNotAcceptedError:
                if time.monotonic() > end:
                    raise
        inside = None
        while self._time < sent + DEADLINE:
            self._spin()
            if self._state is None or state_error(self._state, goal) > SETTLED:
                inside = None
            elif inside is None:
                inside = self._time
            elif self._time > inside + STAYED:
                return inside - sent
        return math.inf

    def _spin(self) -> None:
        rclpy.spin_once(self._node, timeout_sec=0.05)

    def _take_pose(self, message: PoseStamped) -> None:
        self._time = seconds(stamp_from_ros(message.header.stamp))
        self._state = pose_from_ros(message)

    def _take_status(self, message: DiagnosticStatus) -> None:
        self._status = {pair.key: pair.value for pair in message.values}
        age = float(self._status["pose_age_s"])
        if math.isfinite(age):
            self._ages.append(age)


def _tell(results: list[dict[str, object]]) -> None:
    table = Table(*results[0])
    for row in results:
        table.add_row(*(str(value) for value in row.values()))
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main())
