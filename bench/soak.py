# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Long runs to random goals: memory, open files, quaternion norm and missed goals.

    python bench/soak.py lockstep --minutes 60 --json out/soak_lockstep.json    # simulated minutes
    python bench/soak.py realtime --minutes 10 --json out/soak_realtime.json    # 500 Hz

A goal is sent when the one before has been reached; it counts as missed when it is not reached
within `DEADLINE` of simulated time. After each goal the processes are sampled. Memory is the
resident set of each node, as the mean over the first and over the last minute of simulated time (a
tenth of the run where that is shorter).
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import psutil
from geometry_msgs.msg import PoseStamped
from machine import machine, write_json
from node_runs import PATIENCE, Observer, running
from rclpy.serialization import deserialize_message

from sphere_nmpc.model.rotation import random_quaternion
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError

DEADLINE = 60.0
"""Time to a goal after which it counts as missed [s]."""
REACH = 2.0
"""Largest |x| and |y| of a goal [m]."""
_MINUTE, _MEGABYTE = 60.0, 2.0**20


def samples_of(observer: Observer) -> dict[str, list[float]]:
    """Return memory [bytes], open files and child processes of each node, and the norm's error."""
    found: dict[str, list[float]] = {}
    for name, pid in observer.processes.pids.items():
        process = psutil.Process(pid)
        children = len(process.children(recursive=True))
        found[name] = [process.memory_info().rss, process.num_fds(), children]
    turn = deserialize_message(observer.record.newest_pose, PoseStamped).pose.orientation
    found["norm"] = [abs(float(np.linalg.norm((turn.w, turn.x, turn.y, turn.z))) - 1.0)]
    return found


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
    wall, rng = time.monotonic(), np.random.default_rng(given.seed)
    settled: list[float] = []
    missed: list[float] = []
    with running(simulator, {"strategy": given.strategy, **controller}) as observer:
        observer.begin()
        goals = observer.goals
        begin, samples = goals.time, [(goals.time, samples_of(observer))]
        end = begin + _MINUTE * given.minutes
        while goals.time < end:
            goal = np.concatenate((rng.uniform(-REACH, REACH, 2), random_quaternion(rng)))
            timeout = min(DEADLINE, end - goals.time)
            try:
                took = goals.go(goal, timeout, PATIENCE)
            except GoalNotAcceptedError:
                took, timeout = None, DEADLINE
            if took is not None:
                settled.append(took)
            elif timeout == DEADLINE:  # one that the end of the run cuts short does not count
                missed.append(goals.time)
            samples.append((goals.time, samples_of(observer)))
            print(f"{end - goals.time:.0f} s left, {len(settled)} reached, {len(missed)} missed",
                  flush=True)
        status = observer.record.statuses[-1]
    window = min(_MINUTE, 0.1 * _MINUTE * given.minutes)
    parts = ([s for t, s in samples if t <= begin + window],
             [s for t, s in samples if t >= samples[-1][0] - window])
    means = [{name: np.mean([s[name] for s in part], axis=0) for name in part[0]}
             for part in parts]
    result: dict[str, object] = {
        "machine": machine(), "mode": given.mode, "strategy": given.strategy,
        "simulated_s": round(samples[-1][0] - begin, 1),
        "wall_s": round(time.monotonic() - wall, 1),
        "goals_reached": len(settled), "goals_missed_at_s": missed,
        "settle_s_median": float(np.median(settled)) if settled else None,
        "settle_s_longest": max(settled, default=None),
        "counts": {k: status[k] for k in ("failures", "missed_ticks", "late_poses")},
        "window_s": window,
        "quaternion_norm_error": max(s["norm"][0] for _, s in samples),
    }
    for name in ("simulator", "controller"):
        memory, files, children = np.array([mean[name] for mean in means]).T
        result[name] = {
            "memory_MB": (memory / _MEGABYTE).round(2).tolist(),
            "open_files": files.round(1).tolist(), "children": children.round(1).tolist(),
        }
    for key, value in result.items():
        print(f"{key}: {value}")
    write_json(given.json, result)
    return 1 if missed or not settled else 0


if __name__ == "__main__":
    sys.exit(main())
