# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Actions of the navigator at random instants: goals, cancels, takeovers, and killed nodes.

    python bench/navigation_actions.py --number 100 --kills 5 --json out/navigation_actions.json

Simulator, controller and navigator run as processes, in simulated time at four times the pace.
Each trial begins with a goal. That is reached; or it is cancelled, or another one takes over, of
an action or on `goal_pose`, within the first second of wall time; or a node is killed (SIGKILL)
and started again while the sphere moves. Wrong is an end that does not follow from that, more than
one end, a sphere that moves after a cancel, and none within ten minutes. Where nav2_msgs is not
installed, `test/support/navigation_messages.py` builds it. Returns 0 if nothing is wrong.
"""

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from node_runs import machine, write_json
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.study.progress import shown

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
import navigation_messages
from navigation_client import Sent, drawn, pose
from navigation_session import AT_REST, Session
from ros_graph import Graph

_WITHIN = 1.0
"""Longest time from a goal to what ends it [s, wall]."""
_AWAY = 2.5
"""Distance of a goal during which a node is killed [m]."""


class Trials:
    """Trials of each kind, which return what happened; wrong ones raise an AssertionError."""

    def __init__(self, session: Session, rng: np.random.Generator) -> None:
        self._session, self._client, self._rng = session, session.client, rng
        self._others = session.graph.publisher(PoseStamped, "goal_pose")

    def goal(self) -> str:
        """Reach a goal, or two in order."""
        poses = [drawn(self._rng) for _ in range(self._rng.integers(1, 3))]
        return self._expect(self._client.send(*poses), "succeeded")

    def cancel(self) -> str:
        """Cancel a goal."""
        sent = self._client.send(drawn(self._rng))
        self._wait()
        if not self._client.cancel(sent):
            return self._expect(sent, "succeeded")
        self._expect(sent, "canceled")
        assert self._session.way_at_rest() < AT_REST, "it moves after a cancel"
        return "canceled"

    def takeover(self) -> str:
        """Send another goal before the first is reached."""
        first = self._client.send(drawn(self._rng))
        self._wait()
        if self._rng.integers(2):
            self._expect(self._client.send(drawn(self._rng)), "succeeded")
        else:
            self._others.publish(drawn(self._rng))
        return self._expect(first, "aborted", "succeeded")

    def killed_controller(self) -> str:
        """Kill the controller, which goes on to its goal when it is started again."""
        return self._killed("controller")

    def killed_simulator(self) -> str:
        """Kill the simulator, which begins anew, and the sphere rolls to the same goal."""
        return self._killed("simulator")

    def killed_navigator(self) -> str:
        """Kill the navigator, whose goal has no end; the sphere goes on."""
        self._begin_far()
        known = self._client.navigators()
        self._session.restart("navigator")
        self._session.graph.until(lambda: self._client.navigators() - known)
        self._session.graph.until(lambda: self._session.status()["mode"] == "at the goal")
        return self.goal()

    def _killed(self, node: str) -> str:
        sent = self._begin_far()
        self._session.restart(node)
        return self._expect(sent, "succeeded")

    def _begin_far(self) -> Sent:
        side = -np.sign(self._session.place[0]) or 1.0
        sent = self._client.send(pose(side * _AWAY, self._rng.uniform(-1.0, 1.0)))
        self._session.moves()
        return sent

    def _wait(self) -> None:
        self._session.graph.spin_for(self._rng.uniform(0.0, _WITHIN))

    def _expect(self, sent: Sent, *ends: str) -> str:
        (end,) = self._client.wait(sent)
        assert end in ends, f"{end}: {sent.reason}"
        return end


def run(trials: Trials, planned: list[str]) -> tuple[Counter[str], list[str]]:
    """Carry out trials of the planned kinds; return how many had which end, and what was wrong."""
    ends: Counter[str] = Counter()
    wrong: list[str] = []
    bar = Progress(
        TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[last]}"),
        TextColumn("to go"), TimeRemainingColumn(), console=Console(stderr=True),
    )
    task = bar.add_task("trials", total=len(planned), last="")
    with shown(bar):
        for number, kind in enumerate(planned):
            trial: Callable[[], str] = getattr(trials, kind)
            try:
                end = trial()
            except AssertionError as error:
                end = "wrong"
                wrong.append(f"{number} {kind}: {error}")
            ends[f"{kind.replace('_', ' ')}: {end}"] += 1
            bar.update(task, advance=1, last=f"{len(wrong)} wrong")
    return ends, wrong


def main() -> int:
    """Carry out all trials in random order and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=100, help="of goals, cancels and takeovers")
    parser.add_argument("--kills", type=int, default=5, help="of each node")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    planned = ["goal", "cancel", "takeover"] * given.number
    planned += ["killed_controller", "killed_simulator", "killed_navigator"] * given.kills
    rng.shuffle(planned)
    navigation_messages.provide()
    with own_domain(), tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder  # the stored goal
        with ProcessSet(Path(folder)) as processes:
            graph = Graph()
            try:
                ends, wrong = run(Trials(Session(graph, processes), rng), planned)
            finally:
                rclpy.try_shutdown()
    for name in sorted(ends):
        print(f"{name} {ends[name]}")
    for line in wrong:
        print(line)
    print(f"{len(planned)} trials, {len(wrong)} wrong")
    write_json(given.json, {"machine": machine(), "ends": ends, "wrong": wrong})
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
