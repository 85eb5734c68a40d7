# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Long runs to random goals: memory, open files, processes, quaternion norm and missed goals.

    python bench/soak.py lockstep --minutes 60 --json out/soak_lockstep.json    # simulated minutes
    python bench/soak.py realtime --minutes 10 --json out/soak_realtime.json    # 500 Hz

A goal is sent when the one before has been reached; it counts as missed when it is not reached
within `DEADLINE` of simulated time. Memory is the resident set of each node, as the mean over the
first and over the last minute of simulated time (a tenth of the run where that is shorter).
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

from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.ros.messages import seconds, stamp_from_ros
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.goal_run import GoalRunner
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError
from sphere_sim.ros.session.process_set import ProcessSet

DEADLINE = 60.0
"""Time to a goal after which it counts as missed [s]."""
REACH = 2.0
"""Largest |x| and |y| of a goal [m]."""
_SPIN_PERIOD = 0.02
"""Wall time between two readings of the newest messages [s]."""
_SAMPLE_PERIOD = 0.5
"""Wall time between two samples of the processes [s]."""
_MINUTE = 60.0
_MEGABYTE = 2.0**20
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

Sample = tuple[float, dict[str, tuple[int, int, int]]]
"""Simulated time [s], and of each node memory [bytes], open files and child processes."""


class Soak:
    """Node that sends goals and samples the processes; it needs little processor time itself."""

    def __init__(self, nodes: ProcessSet, seed: int) -> None:
        self._nodes = nodes
        self._processes = {n: psutil.Process(pid) for n, pid in nodes.pids.items()}
        self._rng = np.random.default_rng(seed)
        self._node = rclpy.create_node("soak")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._goals = GoalRunner(self._node, self._spin)
        self._node.create_subscription(PoseStamped, "pose", self._take_pose, _NEWEST)
        self._node.create_subscription(
            DiagnosticStatus, "controller/status", self._take_status, _NEWEST
        )
        self._sampled = -math.inf
        self.status: dict[str, str] = {}
        self.samples: list[Sample] = []
        self.norms: list[tuple[float, float]] = []
        self.settled: list[float] = []
        self.missed: list[float] = []

    def run(self, duration: float, report: Callable[[str], object]) -> None:
        """Send goals for a simulated time [s]; `report` is given a line of progress at times."""
        self._goals.prepare(PATIENCE)
        # The memory that a node takes to start is no growth.
        self.samples.clear()
        self.norms.clear()
        self._sampled = -math.inf
        end, reported = self._goals.time + duration, time.monotonic()
        while self._goals.time < end:
            self._one_goal(end)
            if time.monotonic() > reported + 20.0:
                reported = time.monotonic()
                left = end - self._goals.time
                counts = f"{len(self.settled)} reached, {len(self.missed)} missed"
                report(f"{left:.0f} s left, {counts}")

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _one_goal(self, end: float) -> None:
        """Run to a random goal; one that the end of the run cuts short does not count."""
        rng = self._rng
        goal = np.concatenate((rng.uniform(-REACH, REACH, 2), random_quaternion(rng)))
        timeout = min(DEADLINE, end - self._goals.time)
        try:
            took = self._goals.go(goal, timeout, PATIENCE)
        except GoalNotAcceptedError:
            took, timeout = None, DEADLINE
        if took is not None:
            self.settled.append(took)
        elif timeout == DEADLINE:
            self.missed.append(self._goals.time)

    def _spin(self) -> None:
        """Take the newest messages, and sample the processes when that is due."""
        time.sleep(_SPIN_PERIOD)
        for _ in range(5):
            self._executor.spin_once(timeout_sec=0.0)
        if time.monotonic() > self._sampled + _SAMPLE_PERIOD:
            self._sampled = time.monotonic()
            self._nodes.check()
            sample = {name: _sample(process) for name, process in self._processes.items()}
            self.samples.append((self._goals.time, sample))

    def _take_pose(self, message: PoseStamped) -> None:
        turn = message.pose.orientation
        norm = math.sqrt(turn.w**2 + turn.x**2 + turn.y**2 + turn.z**2)
        self.norms.append((seconds(stamp_from_ros(message.header.stamp)), abs(norm - 1.0)))

    def _take_status(self, message: DiagnosticStatus) -> None:
        self.status = {value.key: value.value for value in message.values}


def main() -> int:
    """Run, print the figures, and return 0 if no goal was missed."""
    given = _parse()
    duration = _MINUTE * given.minutes
    wall = time.monotonic()
    with (
        own_domain() as domain,
        tempfile.TemporaryDirectory() as logs,
        ProcessSet(Path(logs)) as nodes,
    ):
        earlier = _shared_memory(domain)
        for verb, parameters in _parameters(given).items():
            options = [part for item in parameters for part in ("-p", item)]
            nodes.start(verb, ["--ros-args", *options])
        rclpy.init(args=[])
        try:
            soak = Soak(nodes, given.seed)
            soak.run(duration, lambda line: print(line, flush=True))
            soak.close()
        finally:
            rclpy.try_shutdown()
        pids = list(nodes.pids.values())
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
        simulator = ["lockstep:=true", "real_time_factor:=0.0", "pose_rate:=20.0",
                     "lockstep_timeout:=30.0"]
        return {"simulator": simulator, "controller": [*controller, "lockstep:=true"]}
    rate = [f"control_rate:={given.rate}", f"command_rate:={given.rate}"]
    return {"simulator": [f"pose_rate:={given.rate}"], "controller": [*controller, *rate]}


def _sample(process: psutil.Process) -> tuple[int, int, int]:
    return process.memory_info().rss, process.num_fds(), len(process.children(recursive=True))


def _shared_memory(domain: int) -> list[str]:
    """Return the shared memory files of the ports of a domain."""
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
        means = [np.mean([sample[name] for _, sample in part], axis=0) for part in parts]
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
