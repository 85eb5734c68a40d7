# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Load of a viewer on the control loop: periods and missed ticks with and without it.

    python bench/viewer_load.py --seconds 60                      # about four minutes

At a control rate of 100 Hz, from the controller's own diagnostics: without a viewer, with a viewer
whose page is not open, and with the page open in a headless Chromium, which renders on the
processor. Another goal every few seconds keeps the sphere moving.
"""

import argparse
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from node_runs import node_processes
from rclpy.node import Node

from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.session.serving import serve_until
from sphere_sim.scenario.scenarios import draw_scenarios

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "test" / "sphere_sim" / "viewer"))

from browser import Browser, find_browser  # noqa: E402

CONDITIONS = ("no viewer", "viewer, no page", "viewer and page")


def wait_for(probe: Node, condition: Callable[[], object]) -> None:
    """Serve the probe until a condition holds."""
    if not serve_until(lambda: rclpy.spin_once(probe, timeout_sec=0.1), condition, 60.0):
        raise SystemExit("the nodes were not ready within 60 s")


def measure(condition: str, seconds: float) -> str:
    """Return the row of a condition."""
    loops: list[dict[str, str]] = []

    def note(message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "controller: loop":
                loops.append({pair.key: pair.value for pair in status.values})

    with ExitStack() as stack:
        nodes = stack.enter_context(node_processes({}, {"control_rate": 100.0}))
        if condition != CONDITIONS[0]:
            nodes.start("viewer", ["--port", "0"])
        probe = rclpy.create_node("probe")
        probe.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
        goals = probe.create_publisher(PoseStamped, "goal_pose", 1)
        wait_for(probe, lambda: goals.get_subscription_count() > 0 and loops)
        time.sleep(3.0)  # the start is not measured
        if condition == CONDITIONS[2]:
            wait_for(probe, lambda: "http" in nodes["viewer"].output)
            home = Path(stack.enter_context(
                tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
            ))
            page = stack.enter_context(Browser(find_browser() or "", home, (1200, 800)))
            page.open(re.findall(r"http://\S+", nodes["viewer"].output)[0])
            page.settle()
        scenarios = iter(draw_scenarios(100, 3))
        began, due, first = time.monotonic(), 0.0, len(loops)
        while time.monotonic() < began + seconds:
            if time.monotonic() > due:
                due = time.monotonic() + 8.0
                goals.publish(pose_to_ros(next(scenarios).goal, 0, 0.3))
            rclpy.spin_once(probe, timeout_sec=0.1)
    # The percentiles are of the last thousand ticks: ten seconds.
    settled = loops[first:][min(20, (len(loops) - first) // 2):]
    p99 = [float(values["wall period p99 ms"]) for values in settled]
    middle = [float(values["wall period median ms"]) for values in settled]
    missed = int(loops[-1]["missed ticks"]) - int(loops[first - 1]["missed ticks"])
    return (
        f"| {condition} | {np.median(middle):.2f} | {np.median(p99):.2f} | {max(p99):.2f} | "
        f"{missed} | {100.0 * missed / (100.0 * seconds):.2f} | {os.getloadavg()[0]:.1f} |"
    )


def main() -> None:
    """Print a row for each condition."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    given = parser.parse_args()
    print("| condition | median [ms] | p99 [ms] | worst p99 [ms] | missed | of ticks [%] | "
          "load |\n|---|---|---|---|---|---|---|", flush=True)
    for condition in CONDITIONS:
        print(measure(condition, given.seconds), flush=True)


if __name__ == "__main__":
    main()
