# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""High control rates through the nodes: achieved rate, period, latency and missed ticks.

    python bench/control_rate.py --json out/control_rate.json          # about nine minutes
    python bench/control_rate.py --rates 100 --strategies time_optimal --hogs 0 \\
        --viewers none idle page                                       # about four minutes

The simulator publishes as many poses as the controller solves plans. Every few seconds another
drawn goal keeps the sphere moving. Latency is the time from the publication of the pose of a
sampling instant to that of its command. With ``hogs`` another process keeps a processor busy. A
viewer runs without its page, or with it in a headless Chromium, which draws on the processor.
The last two columns are the processor time of each node, with its worker, for a sampling instant.
"""

import argparse
import itertools
import math
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from machine import machine, write_json
from node_runs import PATIENCE, Observer, Record, hogs, running

from sphere_nmpc.model.state import Vector
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.scenario.scenarios import draw_scenarios

_NEW_GOAL_EVERY = 8.0
"""Simulated time between two goals [s]."""
_COLUMNS = {
    "strategy": "s", "rate_hz": ".0f", "hogs": "d", "viewer": "s",
    "achieved_hz": ".1f", "period_p50_ms": ".2f", "period_p99_ms": ".2f",
    "latency_p50_ms": ".2f", "latency_p99_ms": ".2f",
    "solve_p50_ms": ".3f", "solve_p99_ms": ".3f", "tick_p50_ms": ".3f", "missed": "d",
    "missed_percent": ".3f", "pace": ".3f", "controller_ms": ".3f", "simulator_ms": ".3f",
}


@contextmanager
def viewed(nodes: ProcessSet, viewer: str) -> Iterator[None]:
    """Run a viewer beside the nodes: none, an idle one, or one whose page is open."""
    tests = Path(__file__).parents[1] / "test"
    sys.path += map(str, (tests / "support", tests / "browser"))
    from browser import Browser, find_browser

    with ExitStack() as stack:
        if viewer != "none":
            process, found = nodes.start("viewer", ["--port", "0"]), None
            while found is None:
                process.check()
                time.sleep(0.1)
                found = re.search(r"http://\S+", process.output)
            if viewer == "page":
                home = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
                folder = Path(stack.enter_context(home))
                page = stack.enter_context(Browser(find_browser() or "", folder, (1200, 800)))
                page.open(found.group())
                page.settle()
        yield


def measure(
    strategy: str, rate: float, hogged: int, viewer: str, duration: float, priority: int
) -> dict[str, Any]:
    """Run both nodes for a while and return the figures."""
    goals = itertools.cycle(scenario.goal for scenario in draw_scenarios(50, 3))
    simulator: dict[str, object] = {"pose_rate": rate, "thread_priority": priority}
    controller: dict[str, object] = {
        "strategy": strategy, "control_rate": rate, "command_rate": 100.0,
        "thread_priority": priority,
    }
    with (
        running(simulator, controller) as observer, hogs(hogged),
        viewed(observer.processes, viewer),
    ):
        observer.begin()
        before = observer.processor_time()
        _drive(observer, goals, duration)
        spent = {
            # Processor time for each sampling instant.
            f"{name}_ms": 1e3 * (time - before[name]) / (duration * rate)
            for name, time in observer.processor_time().items()
        }
        return {
            "strategy": strategy, "rate_hz": rate, "hogs": hogged, "viewer": viewer,
            "duration_s": duration, "thread_priority": priority,
            **figures(observer.record, rate), **spent,
        }


def figures(record: Record, rate: float) -> dict[str, float]:
    """Return rate, period and latency of the commands that were sent."""
    stamps, written = np.array(record.command_stamps), np.array(record.command_written)
    poses, poses_written = np.array(record.pose_stamps), np.array(record.pose_written)
    # The newest pose of the instant of each command.
    newest = np.searchsorted(poses, stamps + 1e-6, side="right") - 1
    known = newest >= 0
    gaps = np.diff(written)
    gaps = gaps[gaps < 0.2]  # at rest between two goals no command is needed
    solving = [s for s in record.statuses if s["mode"] == "on the way to the goal"]
    measured: dict[str, Any] = {
        "period": gaps, "latency": written[known] - poses_written[newest[known]],
        "solve": [float(s["solve_time_s"]) for s in solving],
        "tick": [float(s["tick_time_s"]) for s in solving],
    }
    percentiles = {
        f"{name}_p{percent}_ms": 1e3 * float(np.percentile(values, percent))
        for name, values in measured.items() for percent in (50, 99)
    }
    missed = int(record.statuses[-1]["missed_ticks"])
    running_time = poses > poses[0]  # time was paused before
    simulated, wall = np.ptp(poses[running_time]), np.ptp(poses_written[running_time])
    return {
        "commands": len(stamps),
        "achieved_hz": float(gaps.size / gaps.sum()),
        **percentiles,
        "missed": missed, "missed_percent": 100.0 * missed / (simulated * rate),
        "pace": float(simulated / wall),
    }


def _drive(observer: Observer, goals: "itertools.cycle[Vector]", duration: float) -> None:
    record = observer.record
    end, next_goal = record.pose_stamps[-1] + duration, -math.inf
    while record.pose_stamps[-1] < end:
        if record.pose_stamps[-1] >= next_goal:
            next_goal = record.pose_stamps[-1] + _NEW_GOAL_EVERY
            observer.goals.send(next(goals), PATIENCE)
        before = record.pose_stamps[-1]
        target = min(end, next_goal)
        if not observer.until(lambda: record.pose_stamps[-1] >= target, 120.0):  # noqa: B023
            raise RuntimeError(f"time stands still at {before:.2f} s")


def main() -> int:
    """Measure all combinations and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 500.0])
    parser.add_argument("--strategies", nargs="+", default=["paper", "time_optimal"])
    parser.add_argument("--hogs", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--viewers", choices=("none", "idle", "page"), nargs="+", default=["none"])
    parser.add_argument("--duration", type=float, default=60.0, help="simulated time of each [s]")
    parser.add_argument("--priority", type=int, default=1, help="of both nodes, 0 is ordinary")
    parser.add_argument("--json", type=Path, help="file for the results")
    options = parser.parse_args()
    about, rows = machine(), []
    print(f"{about['date']}, load {about['load_average']}\n\n| {' | '.join(_COLUMNS)} |")
    print(f"|{'---|' * len(_COLUMNS)}")
    for hogged, strategy, rate, viewer in itertools.product(
        options.hogs, options.strategies, options.rates, options.viewers
    ):
        row = measure(strategy, rate, hogged, viewer, options.duration, options.priority)
        row["load_average"] = machine()["load_average"]
        rows.append(row)
        cells = (format(row[name], how) for name, how in _COLUMNS.items())
        print(f"| {' | '.join(cells)} |", flush=True)
    write_json(options.json, {"machine": about, "rows": rows})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
