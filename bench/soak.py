# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Long runs to random goals: memory, open files, quaternion norm and missed goals.

    python bench/soak.py lockstep --minutes 60 --json out/soak_lockstep.json    # simulated minutes
    python bench/soak.py realtime --minutes 10 --json out/soak_realtime.json    # 500 Hz

A goal is sent when the one before has been reached; it counts as missed when it is not reached
within `DEADLINE` of simulated time. Memory is the resident set of each node, as the mean over the
first and over the last minute of simulated time (a tenth of the run where that is shorter).
"""

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from node_runs import PATIENCE, machine, node_processes, write_json
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.ros.messages import seconds, stamp_from_ros
from sphere_sim.ros.session.goal_run import GoalRunner
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError
from sphere_sim.ros.session.process_set import ProcessSet

DEADLINE = 60.0
"""Time to a goal after which it counts as missed [s]."""
REACH = 2.0
"""Largest |x| and |y| of a goal [m]."""
_SPIN_PERIOD, _SAMPLE_PERIOD, _REPORT_PERIOD = 0.02, 0.5, 20.0
"""Wall time between two readings of the newest messages, samples of the processes, lines [s]."""
_MINUTE = 60.0
_MEGABYTE = 2.0**20
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Soak:
    """Node that sends goals and samples the processes; it needs little processor time itself."""

    def __init__(self, nodes: ProcessSet, seed: int) -> None:
        self._nodes = nodes
        self._processes = {n: psutil.Process(pid) for n, pid in nodes.pids.items()}
        self._rng = np.random.default_rng(seed)
        node = rclpy.create_node("soak")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._goals = GoalRunner(node, self._spin)
        node.create_subscription(PoseStamped, "pose", self._take_pose, _NEWEST)
        node.create_subscription(DiagnosticStatus, "controller/status", self._take_status, _NEWEST)
        self._sampled = self._reported = -math.inf
        self.status: dict[str, str] = {}
        self.samples: dict[str, list[tuple[float, ...]]] = {name: [] for name in self._processes}
        """Of each node simulated time [s], memory [bytes], open files and child processes."""
        self.norms: list[tuple[float, float]] = []
        """Simulated time [s] and deviation of the quaternion's norm from one."""
        self.settled: list[float] = []
        self.missed: list[float] = []

    def run(self, duration: float) -> None:
        """Send goals for a simulated time [s]."""
        self._goals.prepare(PATIENCE)
        # The memory that a node takes to start is no growth.
        for samples in self.samples.values():
            samples.clear()
        self.norms.clear()
        end = self._goals.time + duration
        while self._goals.time < end:
            self._one_goal(end)
            if time.monotonic() > self._reported + _REPORT_PERIOD:
                self._reported = time.monotonic()
                counts = f"{len(self.settled)} reached, {len(self.missed)} missed"
                print(f"{end - self._goals.time:.0f} s left, {counts}", flush=True)

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
            for name, process in self._processes.items():
                children = len(process.children(recursive=True))
                self.samples[name].append(
                    (self._goals.time, process.memory_info().rss, process.num_fds(), children)
                )

    def _take_pose(self, message: PoseStamped) -> None:
        turn = message.pose.orientation
        norm = math.sqrt(turn.w**2 + turn.x**2 + turn.y**2 + turn.z**2)
        self.norms.append((seconds(stamp_from_ros(message.header.stamp)), abs(norm - 1.0)))

    def _take_status(self, message: DiagnosticStatus) -> None:
        self.status = {value.key: value.value for value in message.values}


def main() -> int:
    """Run, print the figures, and return 0 if no goal was missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mode", choices=("lockstep", "realtime"))
    parser.add_argument("--minutes", type=float, default=10.0, help="simulated")
    parser.add_argument("--rate", type=float, default=500.0,
                        help="of poses and control in real time [Hz]")
    parser.add_argument("--strategy", default="time_optimal")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if given.mode == "lockstep":
        simulator: dict[str, object] = {
            "lockstep": True, "real_time_factor": 0.0, "pose_rate": 20.0, "lockstep_timeout": 30.0
        }
        controller: dict[str, object] = {"lockstep": True}
    else:
        simulator = {"pose_rate": given.rate}
        controller = {"control_rate": given.rate, "command_rate": given.rate}
    wall, duration = time.monotonic(), _MINUTE * given.minutes
    with node_processes(simulator, {"strategy": given.strategy, **controller}) as nodes:
        soak = Soak(nodes, given.seed)
        soak.run(duration)
    result: dict[str, object] = {
        "machine": machine(), "mode": given.mode, "strategy": given.strategy,
        "simulated_s": round(soak.norms[-1][0] - soak.norms[0][0], 1),
        "wall_s": round(time.monotonic() - wall, 1),
        "goals_reached": len(soak.settled), "goals_missed_at_s": soak.missed,
        "settle_s_median": float(np.median(soak.settled)) if soak.settled else None,
        "settle_s_longest": max(soak.settled, default=None),
        "counts": {k: soak.status[k] for k in ("failures", "missed_ticks", "late_poses")},
        **_first_and_last(soak, min(_MINUTE, 0.1 * duration)),
    }
    for key, value in result.items():
        print(f"{key}: {value}")
    write_json(given.json, result)
    return 1 if soak.missed or not soak.settled else 0


def _first_and_last(soak: Soak, window: float) -> dict[str, object]:
    """Compare the first and the last `window` [s] of memory, files, processes and norms."""
    begin, end = soak.norms[0][0] + window, soak.norms[-1][0] - window
    table: dict[str, object] = {"window_s": window}
    for name, found in soak.samples.items():
        samples = np.array(found)
        parts = samples[samples[:, 0] <= begin], samples[samples[:, 0] >= end]
        memory, files, children = np.array([part[:, 1:].mean(axis=0) for part in parts]).T
        table[name] = {
            "memory_MB": (memory / _MEGABYTE).round(2).tolist(),
            "open_files": files.round(1).tolist(), "children": children.round(1).tolist(),
        }
    times, errors = np.array(soak.norms).T
    table["quaternion_norm_error"] = [
        float(errors[times <= begin].max()), float(errors[times >= end].max())
    ]
    return table


if __name__ == "__main__":
    sys.exit(main())
