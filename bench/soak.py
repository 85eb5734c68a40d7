# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals one after another through the nodes: missed goals and instants, memory, open files.

    python bench/soak.py lockstep --minutes 60 --json out/soak_lockstep.json    # simulated minutes
    python bench/soak.py realtime --minutes 10 --json out/soak_realtime.json    # 500 Hz
    python bench/soak.py drawn --draw 20 --seed 1              # the first scenarios of a study
    python bench/soak.py drawn --draw 20 --seed 1 --clock system

A goal is sent when the one before has been reached; it counts as missed when it is not reached
within `DEADLINE` of simulated time. A miss is a sampling instant at which no command was sent, as
planning took longer or other processes had the processor. After each goal the processes are
sampled. Memory is the resident set of each node, as the mean over the first and over the last
minute of simulated time (a tenth of the run where that is shorter).
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from geometry_msgs.msg import PoseStamped
from machine import machine, write_json
from node_runs import PATIENCE, Observer, running
from rclpy.serialization import deserialize_message

from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.ros.session.goal_sender import GoalNotAcceptedError
from sphere_sim.ros.simulator.settings import CLOCKS
from sphere_sim.scenario.scenarios import draw_scenarios

DEADLINE = 60.0
"""Time to a goal after which it counts as missed [s]."""
REACH = 2.0
"""Largest |x| and |y| of a goal [m]."""
_MINUTE, _MEGABYTE = 60.0, 2.0**20
_COLUMNS = {
    "misses": "6d", "first_plan_ms": "13.1f", "longest_plan_ms": "15.1f", "settled_s": "9.2f",
    "final_error": "11.2e",
}
Sample = dict[str, list[float]]


def sample_of(observer: Observer) -> Sample:
    """Return memory [bytes], open files and child processes of each node, and the norm's error."""
    found: Sample = {}
    for name, pid in observer.processes.pids.items():
        process = psutil.Process(pid)
        children = len(process.children(recursive=True))
        found[name] = [process.memory_info().rss, process.num_fds(), children]
    turn = deserialize_message(observer.record.newest_pose, PoseStamped).pose.orientation
    found["norm"] = [abs(float(np.linalg.norm((turn.w, turn.x, turn.y, turn.z))) - 1.0)]
    return found


def one_run(observer: Observer, goal: Vector, longest: float) -> dict[str, Any]:
    """Run to a goal for up to a time [s] and return the figures of the run."""
    statuses, settled, timeout = observer.record.statuses, None, longest
    missed, first = int(statuses[-1]["missed_ticks"]), len(statuses)
    try:
        settled = observer.goals.go(goal, longest, PATIENCE)
    except GoalNotAcceptedError:
        timeout = DEADLINE
    plans = [
        1e3 * float(status["solve_time_s"])
        for status in statuses[first:] if status["mode"] == "on the way to the goal"
    ]
    return {
        "misses": int(statuses[-1]["missed_ticks"]) - missed,
        "first_plan_ms": plans[0] if plans else math.nan,
        "longest_plan_ms": max(plans, default=math.nan),
        "settled_s": math.nan if settled is None else settled,
        "final_error": math.nan if observer.goals.run is None else observer.goals.run.error,
        "ended_s": observer.goals.time,
        # One that the end of the measurement cuts short does not count.
        "is_missed": settled is None and timeout == DEADLINE,
    }


def parameters(given: argparse.Namespace) -> tuple[dict[str, object], dict[str, object]]:
    """Return the parameters of simulator and controller."""
    if given.mode == "lockstep":
        return {
            "lockstep": True, "real_time_factor": 0.0, "pose_rate": 20.0, "lockstep_timeout": 30.0
        }, {"lockstep": True}
    if given.mode == "realtime":
        rates = {"control_rate": given.rate, "command_rate": given.rate}
        return {"pose_rate": given.rate}, dict(rates)
    start = ", ".join(repr(float(value)) for value in draw_scenarios(1, given.seed)[0].start)
    return {"initial_state": f"[{start}]", "clock": given.clock}, {}


def goals_of(given: argparse.Namespace) -> Iterator[Vector]:
    """Yield the goals, those of scenarios or random ones without end."""
    if given.mode == "drawn":
        yield from (scenario.goal for scenario in draw_scenarios(given.draw, given.seed))
        return
    rng = np.random.default_rng(given.seed)
    while True:
        yield np.concatenate((rng.uniform(-REACH, REACH, 2), random_quaternion(rng)))


def by_node(samples: list[tuple[float, Sample]], window: float) -> dict[str, object]:
    """Return what each node takes in the mean of the first and of the last `window` [s]."""
    begin, end = samples[0][0], samples[-1][0]
    parts = ([s for t, s in samples if t <= begin + window],
             [s for t, s in samples if t >= end - window])
    found: dict[str, object] = {}
    for name in ("simulator", "controller"):
        means = [np.mean([s[name] for s in part], axis=0) for part in parts]
        memory, files, children = np.array(means).T
        found[name] = {
            "memory_MB": (memory / _MEGABYTE).round(2).tolist(),
            "open_files": files.round(1).tolist(), "children": children.round(1).tolist(),
        }
    return found


def main() -> int:
    """Run, print the figures, and return 0 if no goal was missed, of drawn ones no instant."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mode", choices=("lockstep", "realtime", "drawn"))
    parser.add_argument("--minutes", type=float, default=10.0, help="simulated")
    parser.add_argument("--rate", type=float, default=500.0,
                        help="of poses and control in real time [Hz]")
    parser.add_argument("--draw", type=int, default=20, help="number of drawn goals")
    parser.add_argument("--clock", choices=CLOCKS, default="simulated", help="for drawn goals")
    parser.add_argument("--strategy", choices=STRATEGIES, default="time_optimal")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    simulator, controller = parameters(given)
    about, wall, runs = machine(), time.monotonic(), list[dict[str, Any]]()
    print(f"{about['date']}, load {about['load_average']}\nrun  {'  '.join(_COLUMNS)}")
    with running(simulator, {"strategy": given.strategy, **controller}) as observer:
        observer.begin()
        begin, samples = observer.goals.time, [(observer.goals.time, sample_of(observer))]
        end = math.inf if given.mode == "drawn" else begin + _MINUTE * given.minutes
        for number, goal in enumerate(goals_of(given)):
            left = end - observer.goals.time
            if left <= 0.0:
                break
            run = one_run(observer, goal, min(DEADLINE, left))
            runs.append(run)
            samples.append((run["ended_s"], sample_of(observer)))
            cells = (format(run[name], how) for name, how in _COLUMNS.items())
            print(f"{number:3d}  {'  '.join(cells)}", flush=True)
        status = observer.record.statuses[-1]
    settled = [run["settled_s"] for run in runs if math.isfinite(run["settled_s"])]
    whole = samples[-1][0] - begin
    window = min(_MINUTE, 0.1 * whole)
    plans = np.array([[run["first_plan_ms"], run["longest_plan_ms"]] for run in runs])
    result: dict[str, object] = {
        "machine": about, "load_average_after": machine()["load_average"],
        "mode": given.mode, "strategy": given.strategy, "simulated_s": round(whole, 1),
        "wall_s": round(time.monotonic() - wall, 1), "goals_reached": len(settled),
        "goals_missed_at_s": [run["ended_s"] for run in runs if run["is_missed"]],
        "settle_s_median": float(np.median(settled)) if settled else None,
        "settle_s_longest": max(settled, default=None),
        "misses": sum(run["misses"] for run in runs),
        "first_and_longest_plan_ms": np.nanmax(plans, axis=0).tolist() if runs else None,
        "counts": {k: status[k] for k in ("failures", "missed_ticks", "late_poses")},
        "window_s": window,
        "quaternion_norm_error": max(s["norm"][0] for _, s in samples),
        **by_node(samples, window),
    }
    for key, value in result.items():
        print(f"{key}: {value}")
    write_json(given.json, {**result, "runs": runs})
    if not settled or result["goals_missed_at_s"]:
        return 1
    return int(given.mode == "drawn" and result["misses"] != 0)


if __name__ == "__main__":
    sys.exit(main())
