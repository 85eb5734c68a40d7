# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random goals for a long time: memory, files, processes, drift of the quaternion, missed goals.

    python bench/soak.py lockstep --minutes 60 --json out/soak_lockstep.json    # simulated minutes
    python bench/soak.py realtime --minutes 10 --json out/soak_realtime.json    # 500 Hz

A goal is sent when the one before has been reached; it counts as missed when it is not within
`DEADLINE` of simulated time. Memory is the resident set of each node, as the mean over the first
and over the last minute of simulated time (a tenth of the run where it is shorter than that).
"""

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from node_runs import PATIENCE, machine, write_json
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.ros.conversions import pose_from_ros, seconds, stamp_from_ros
from sphere_sim.ros.session.children import Children
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError, GoalSender

SETTLED = 1e-2
STAYED = 1.0
"""How long a goal has to be held to count as reached [s]."""
DEADLINE = 60.0
"""Time to a goal after which it counts as missed [s]."""
REACH = 2.0
"""Goals are in a square of twice this size [m]."""
_LOOK = 0.02
"""Wall time between two looks at the newest messages [s]."""
_SAMPLE = 0.5
"""Wall time between two looks at the processes [s]."""
_MINUTE = 60.0
_MEGABYTE = 2.0**20
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

Sample = tuple[float, dict[str, tuple[int, int, int]]]
"""Simulated time [s], and of each node memory [bytes], open files and child processes."""


class Soak:
    """Sends goals and looks, seldom enough to take little time itself."""

    def __init__(self, children: Children, seed: int) -> None:
        self._children = children
        self._processes = {n: psutil.Process(pid) for n, pid in children.pids.items()}
        self._rng = np.random.default_rng(seed)
        self._node = rclpy.create_node("soak")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._sender = GoalSender(self._node, self._spin)
        self._node.create_subscription(PoseStamped, "pose", self._take_pose, _NEWEST)
        self._node.create_subscription(
            DiagnosticStatus, "controller/status", self._take_status, _NEWEST
        )
        self._sampled = -math.inf
        self.time = 0.0
        self.state: Vector | None = None
        self.status: dict[str, str] = {}
        self.samples: list[Sample] = []
        self.norms: list[tuple[float, float]] = []
        self.settled: list[float] = []
        self.missed: list[float] = []

    def run(self, duration: float, tell: Callable[[str], object]) -> None:
        """Send goals for so much simulated time [s]."""
        self._sender.wait_for_controller(PATIENCE)
        while self.state is None:
            self._spin()
        # From here on: what a node takes to come up is no growth.
        self.samples.clear()
        self.norms.clear()
        self._sampled = -math.inf
        end, told = self.time + duration, time.monotonic()
        while self.time < end:
            took = self._one_goal(end)
            if took is not None and math.isfinite(took):
                self.settled.append(took)
            elif took is not None:
                self.missed.append(self.time)
            if time.monotonic() > told + 20.0:
                told = time.monotonic()
                left = end - self.time
                tell(f"{left:.0f} s left, {len(self.settled)} reached, {len(self.missed)} missed")

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _one_goal(self, end: float) -> float | None:
        """Return the time to a goal [s]: inf if it was missed, None if the run ended before."""
        turn = self._rng.normal(size=4)
        goal = np.concatenate((self._rng.uniform(-REACH, REACH, 2), turn / np.linalg.norm(turn)))
        sent = self.time
        try:
            self._sender.send(goal, 0.3, PATIENCE)
        except GoalNotAcceptedError:
            return math.inf
        inside: float | None = None
        while self.time < end:
            self._spin()
            assert self.state is not None
            if self.time > sent + DEADLINE:
                return math.inf
            if state_error(self.state, goal) > SETTLED:
                inside = None
            elif inside is None:
                inside = self.time
            elif self.time > inside + STAYED:
                return inside - sent
        return None

    def _spin(self) -> None:
        """Take what is newest, and look at the processes now and then."""
        time.sleep(_LOOK)
        for _ in range(5):
            self._executor.spin_once(timeout_sec=0.0)
        if time.monotonic() > self._sampled + _SAMPLE:
            self._sampled = time.monotonic()
            self._children.check()
            looks = {name: _look(process) for name, process in self._processes.items()}
            self.samples.append((self.time, looks))

    def _take_pose(self, message: PoseStamped) -> None:
        self.time = seconds(stamp_from_ros(message.header.stamp))
        self.state = pose_from_ros(message)
        turn = message.pose.orientation
        norm = math.sqrt(turn.w**2 + turn.x**2 + turn.y**2 + turn.z**2)
        self.norms.append((self.time, abs(norm - 1.0)))

    def _take_status(self, message: DiagnosticStatus) -> None:
        self.status = {value.key: value.value for value in message.values}


def main() -> int:
    """Run and tell; 0 when no goal was missed."""
    given = _parse()
    duration = _MINUTE * given.minutes
    wall = time.monotonic()
    with (
        own_domain() as domain,
        tempfile.TemporaryDirectory() as logs,
        Children(Path(logs)) as children,
    ):
        earlier = _shared_memory(domain)
        for verb, parameters in _parameters(given).items():
            options = [part for item in parameters for part in ("-p", item)]
            children.start(verb, ["--ros-args", *options])
        rclpy.init(args=[])
        try:
            soak = Soak(children, given.seed)
            soak.run(duration, lambda line: print(line, flush=True))
            soak.close()
        finally:
            rclpy.try_shutdown()
        pids = list(children.pids.values())
    left = [pid for pid in pids if psutil.pid_exists(pid)]
    result: dict[str, object] = {
        "machine": machine(), "mode": given.mode, "strategy": given.strategy,
        "simulated_s": round(soak.norms[-1][0] - soak.norms[0][0], 1),
        "wall_s": round(time.monotonic() - wall, 1),
        "goals_reached": len(soak.settled), "goals_missed_at_s": soak.missed,
        "settle_s_median": float(np.median(soak.settled)) if soak.settled else None,
        "settle_s_longest": max(soak.settled, default=None),
        "counts": {k: soak.status[k] for k in ("failures", "missed_ticks", "late_poses")},
        **_first_and_last(soak, min(_MINUTE, 0.1 * duration)),
        "processes_left": left,
        "shared_memory_left": sorted(set(_shared_memory(domain)) - set(earlier)),
    }
    for key, value in result.items():
        print(f"{key}: {value}")
    write_json(given, result)
    return 1 if soak.missed or left or not soak.settled else 0


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mode", choices=("lockstep", "realtime"))
    parser.add_argument("--minutes", type=float, default=10.0, help="simulated")
    parser.add_argument("--rate", type=float, default=500.0,
                        help="of poses and control in real time [Hz]")
    parser.add_argument("--strategy", default="time_optimal")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def _parameters(given: argparse.Namespace) -> dict[str, list[str]]:
    controller = ["use_sim_time:=true", f"strategy:={given.strategy}"]
    if given.mode == "lockstep":
        period = 0.5 if given.strategy == "paper" else 0.25
        simulator = ["lockstep:=true", "real_time_factor:=0.0", "pose_rate:=20.0",
                     f"sample_period:={period}", "lockstep_timeout:=30.0"]
        return {"simulator": simulator, "controller": [*controller, "lockstep:=true"]}
    rate = [f"control_rate:={given.rate}", f"command_rate:={given.rate}"]
    return {"simulator": [f"pose_rate:={given.rate}"], "controller": [*controller, *rate]}


def _look(process: psutil.Process) -> tuple[int, int, int]:
    return process.memory_info().rss, process.num_fds(), len(process.children(recursive=True))


def _shared_memory(domain: int) -> list[str]:
    """Return the files through which processes of a domain are reached."""
    first = 7400 + 250 * domain
    ports = {f"fastrtps_port{number}" for number in range(first, first + 250)}
    return sorted(path.name for path in Path("/dev/shm").glob("fastrtps_port*")
                  if path.name in ports)


def _first_and_last(soak: Soak, window: float) -> dict[str, object]:
    """Compare the first and the last `window` [s] of memory, files, processes and norms."""
    begin, end = soak.norms[0][0] + window, soak.norms[-1][0] - window
    parts = ([s for s in soak.samples if s[0] <= begin], [s for s in soak.samples if s[0] >= end])
    table: dict[str, object] = {"window_s": window}
    for name in soak.samples[0][1]:
        means = [np.mean([looks[name] for _, looks in part], axis=0) for part in parts]
        table[name] = {
            "memory_MB": [round(float(mean[0]) / _MEGABYTE, 2) for mean in means],
            "open_files": [round(float(mean[1]), 1) for mean in means],
            "children": [round(float(mean[2]), 1) for mean in means],
        }
    table["quaternion_norm_error"] = [
        max(error for when, error in soak.norms if when <= begin),
        max(error for when, error in soak.norms if when >= end),
    ]
    return table


if __name__ == "__main__":
    sys.exit(main())
