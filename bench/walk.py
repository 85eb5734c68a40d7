# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Length of the way through the code: calls, functions, files and records of an instant.

Case 1 is rolled in a closed loop without ROS, in line and with a worker, and between controller
node and simulator over DDS. Counted are calls into sphere_nmpc, distinct functions and files among
them, and kinds of its records (dataclasses, named tuples) that are made, all with what the
controller does. They are those of a typical instant: of each function the median of its calls
counts, so that what few instants do, such as a search that begins, does not change the others.

Counts depend neither on the load nor on the processor: durations are counted in readings of their
clock, simulated time waits for commands on their way and for the worker's results, and what is
made once for each size of a problem is made before. Not committed are ticks that solve with a
search in line, whose effort depends on the last digits, and those of the node: there the instants
at which a search of another process ends are by chance, and with them what is solved.

Times are taken in a second pass, in thousands of additions of small NumPy arrays, and are medians.
The exit status is 1 where a count exceeds that of walk.json.
"""

import argparse
import contextlib
import itertools
import json
import math
import time
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any
from unittest import mock

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.clock_type import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from walk_meter import NEARLY, RESTING, SOLVED, Meter, Walk, after, counts_of

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr_messages import floor_message
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.worker.contract import Reply, Result, Store, Task
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

COMMITTED = Path(__file__).with_name("walk.json")
POSE, GOAL, KNOWN, MAP = "pose", "goal, to first decision", "goal, known", "map, to floor in force"
_VARIES = {"loop": (SOLVED, NEARLY), "node": (SOLVED, NEARLY)}
"""What is not committed."""
COUNTS = "calls", "functions", "files", "records"
PATIENCE = 120.0
"""How long the nodes may take on a busy machine [s]."""
_PERIOD = 0.01
"""Control period [s]: a status is due at each fifth instant."""
_DURATION = 7.0
"""Time of the closed loop [s], which arrives in it."""
_LATE = 3
"""Instants that a worker takes for a task in the loop without ROS."""
_AWAITED = 0.5
"""How long simulated time waits at an instant for tick, command and worker [s, wall]."""
_READING = 2e-4
"""Time between two readings of the clock of durations [s], where calls are counted."""
_GOALS, _KNOWN_GOALS, _MAPS = 9, 9, 3
_BETWEEN = 0.15
"""Wall time between two known goals [s]: each is told."""
_START, _GOAL = PAPER_CASES[1].start, PAPER_CASES[1].goal


class LateWorker:
    """`Worker` that does a task some instants after it was submitted, between two instants."""

    available = True

    def __init__(self) -> None:
        self._store: Store = {}
        self._waiting: deque[tuple[int, Task[Any], Reply[Any]]] = deque()
        self._instant = 0

    def submit(self, task: Task[Result]) -> Reply[Result]:
        """Queue a task."""
        reply: Reply[Result] = Reply()
        self._waiting.append((self._instant + _LATE, task, reply))
        return reply

    def poll(self) -> None:
        """Return at once, as results arrive between two instants."""

    def advance(self) -> None:
        """Do the tasks that are due at the next instant."""
        self._instant += 1
        while self._waiting and self._waiting[0][0] <= self._instant:
            _, task, reply = self._waiting.popleft()
            reply.result, reply.ready = task(self._store), True


def walk_loop(counts: bool, worker: LateWorker | None = None) -> dict[str, list[Walk]]:
    """Return the walks in a closed loop without ROS; without a worker its work is in line."""
    meter = Meter(counts)

    class Walked(Controller):
        """Controller whose sampling instants are recorded."""

        def observe(self, *arguments: Any) -> Any:
            result = meter.run(super().observe, *arguments)
            meter.note(POSE)
            return result

        def decide(self, *arguments: Any) -> Any:
            meter.decision = meter.run(super().decide, *arguments)
            return meter.decision

        def commit(self, *arguments: Any) -> Any:
            result = meter.run(super().commit, *arguments)
            meter.end_tick()
            if worker is not None:
                worker.advance()
            return result

    robot = RobotParameters()
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(_START)), robot, make_plant("rolling", robot, _START)
    )
    settings = ControllerSettings(strategy="time_optimal", control_rate=1.0 / _PERIOD)
    run_closed_loop(simulator, Walked(settings, robot, worker=worker), _GOAL, _DURATION)
    return meter.walks


class NodeWalk:
    """Controller node and simulator in this process, over DDS, and a probe that sends goals."""

    def __init__(self, counts: bool) -> None:
        self.meter, self._maps, self._looks = (Meter(counts) for _ in range(3))
        rates = {"control_rate": 1.0 / _PERIOD, "command_rate": 0.5 / _PERIOD}
        self._node = ControllerNode(_parameters(
            strategy="time_optimal", use_sim_time=True, **rates
        ))
        self._simulator = SimulatorNode(_parameters(
            pose_rate=1.0 / _PERIOD, initial_state=_START.tolist()
        ))
        self._probe = Node("probe")
        self._goal_sender = self._probe.create_publisher(PoseStamped, "goal_pose", 1)
        self._map_sender = self._probe.create_publisher(OccupancyGrid, "map", LATCHED)
        self._executors = SingleThreadedExecutor(), SingleThreadedExecutor()
        for executor, node in zip(self._executors, (self._node, self._simulator), strict=True):
            executor.add_node(node)
        self._node._event_log._period = math.inf  # each is logged once, however fast it runs
        self._node._fault_log._period = math.inf
        self._controller = self._node.controller
        self._floor = self._controller.floor
        self._goals = self._ticks = 0
        self.meter.of(self._controller)
        self._is_on_its_way = False
        """Whether a command has not arrived at the simulator yet."""
        self._replies: list[Reply[Any]] = []
        """Those of the worker."""
        after(self._controller, "commit", self._sent)
        self._worker: Any = self._node._worker
        after(self._worker, "submit", self._replies.append)
        after(topics_of(self._simulator)["/rotor_trajectory"], "callback", self._arrived)
        record, meter = self._record, self.meter
        for timer in self._node.timers:
            is_clocked = timer.clock.clock_type == ClockType.ROS_TIME
            if is_clocked and timer.timer_period_ns == round(1e9 * _PERIOD):
                record(timer, meter, self._end_tick)
            elif timer.callback.__name__ == "_look":
                record(timer, self._looks, self._end_look)
        topics = topics_of(self._node)
        record(topics["/pose"], meter, lambda: meter.end(POSE))
        record(topics["/goal_pose"], meter, self._end_goal, cuts=True)
        record(topics["/map"], self._maps, lambda: None)

    def run(self) -> dict[str, list[Walk]]:
        """Return the walks of goals, of the instants towards one and at it, and of maps."""
        controller = self._controller
        self._until(lambda: self._goal_sender.get_subscription_count() > 0)
        self._until(lambda: len(self.meter.walks[POSE]) > 100)
        goal = _GOAL.copy()
        while len(self.meter.walks[GOAL]) < _GOALS:
            controller.cancel()
            self._until(lambda: controller.is_at_rest(self._simulator.simulator.time))
            goal[0] += 1e-3
            self._send_goal(goal)
        self._until(lambda: controller.at_goal)
        self._until(lambda: len(self.meter.walks[RESTING]) > 100)
        self.meter.walks[KNOWN].clear()
        while len(self.meter.walks[KNOWN]) < _KNOWN_GOALS:
            self._spin_for(_BETWEEN)
            self._send_goal(goal)
        walks = dict(self.meter.walks)  # before there is a floor
        for count in range(_MAPS):
            occupied = np.zeros((200, 200), bool)
            occupied[count] = True
            grid = Grid(occupied, 0.05, (-5.0, -5.0, 0.0))
            self._map_sender.publish(floor_message(grid, 0, "world"))
            self._until(lambda: len(self._maps.walks[MAP]) > count)  # noqa: B023
        return {**walks, MAP: self._maps.walks[MAP]}

    def close(self) -> None:
        """End the nodes."""
        for node in (self._node, self._simulator, self._probe):
            node.destroy_node()

    def _record(
        self, endpoint: Any, meter: Meter, end: Callable[[], None], cuts: bool = False
    ) -> None:
        """Have the callback of a subscription or timer recorded, and `end` called after it."""
        callback = endpoint.callback

        def call(*arguments: Any) -> None:
            meter.run(callback, *arguments, cuts=cuts)
            end()

        endpoint.callback = call

    def _worker_is_busy(self) -> bool:
        self._worker.poll()
        self._replies[:] = [reply for reply in self._replies if reply.pending]
        return bool(self._replies)

    def _sent(self, hold: object) -> None:
        self._is_on_its_way = hold is not None

    def _arrived(self, _: None) -> None:
        self._is_on_its_way = False

    def _end_tick(self) -> None:
        self.meter.end_tick()
        self._ticks += 1

    def _end_goal(self) -> None:
        """End the walk of a goal; without a decision it is a known one."""
        self.meter.end(KNOWN if self.meter.decision is None else GOAL)
        self._goals += 1

    def _end_look(self) -> None:
        """End the walk of a map if its floor is in force now; looks before that do not count."""
        if self._controller.floor is not self._floor:
            self._floor = self._controller.floor
            self._maps.take(self._looks)
            self._maps.end(MAP)
        self._looks.end(None)

    def _send_goal(self, goal: Vector) -> None:
        received = self._goals
        self._goal_sender.publish(pose_to_ros(goal, 0, 0.0))
        self._until(lambda: self._goals > received)

    def _spin_for(self, duration: float) -> None:
        end = time.monotonic() + duration
        self._until(lambda: time.monotonic() > end)

    def _until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"timed out after {PATIENCE:g} s")
            now, ticks = self._simulator.simulator.now, self._ticks
            self._simulator.work(self)  # type: ignore[arg-type]
            has_advanced = self._simulator.simulator.now > now
            awaited = time.monotonic() + _AWAITED
            while time.monotonic() < awaited and (
                (has_advanced and self._ticks == ticks)
                or self._is_on_its_way or self._worker_is_busy()
            ):
                self.spin_once(1e-3)

    def spin_once(self, timeout_sec: float) -> None:
        """Call what is due in both nodes, as an executor of the simulator."""
        end = time.monotonic() + timeout_sec
        while True:
            for executor in self._executors:
                executor.spin_once(timeout_sec=0.0)
            if time.monotonic() >= end:
                break
            time.sleep(2e-4)


def topics_of(node: Node) -> dict[str, Any]:
    """Return the subscriptions of a node by their topics."""
    return {one.topic_name: one for one in node.subscriptions}


def _parameters(**values: Any) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]


def walk_nodes(counts: bool) -> dict[str, list[Walk]]:
    """Return the walks in running nodes."""
    with own_domain(), contextlib.ExitStack() as ends:
        rclpy.init(args=[])
        ends.callback(rclpy.try_shutdown)
        nodes = NodeWalk(counts)
        ends.callback(nodes.close)
        return nodes.run()


def table(found: dict[str, Any], limits: dict[str, Any], times: Any) -> list[str]:
    """Return the rows of the table, with the committed count where it is exceeded."""
    head = ["", *COUNTS, "1000 operations"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for place, kinds in found.items():
        for kind, counts in kinds.items():
            most = limits.get(place, {}).get(kind, counts)
            cells = [str(n) if n <= limit else f"{n} > {limit}"
                     for n, limit in zip(counts, most, strict=True)]
            timed = [walk.time for walk in times.get(place, {}).get(kind, [])]
            cells.append(f"{median(timed):.2f}" if timed else "")
            lines.append(f"| {place}: {kind} | {' | '.join(cells)} |")
    return lines


def exceeded(found: dict[str, Any], limits: dict[str, Any]) -> bool:
    """Return whether a count is above its limit, or an instant of a kind was not seen."""
    return any(
        any(n > most for n, most in zip(found[place].get(kind, [1e9]), counts, strict=False))
        for place, kinds in limits.items() for kind, counts in kinds.items()
    )


def main(arguments: list[str] | None = None) -> int:
    """Print the table, or a profile; return whether the walk is longer than the committed one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--update", action="store_true", help="write the counts to walk.json")
    parser.add_argument("--counts", action="store_true", help="take no times")
    parser.add_argument("--profile", metavar="KIND", help="list functions by number of calls")
    options = parser.parse_args(arguments)
    ways: dict[str, Callable[[bool], dict[str, list[Walk]]]] = {
        "loop": walk_loop,  # first, as what is made once for each size is made here
        "with a worker": lambda counts: walk_loop(counts, LateWorker()),
        "node": walk_nodes,
    }
    readings = itertools.count()
    with mock.patch("time.perf_counter", lambda: _READING * next(readings)):
        walks = {place: way(True) for place, way in ways.items()}
    if options.profile:
        for place, kinds in walks.items():
            for kind in (kind for kind in kinds if kind.startswith(options.profile)):
                calls = Counter(call for walk in kinds[kind] for call in walk.calls)
                print(f"\n{place}: {kind}, calls an instant in the mean")
                for (file, name), number in calls.most_common():
                    print(f"{number / len(kinds[kind]):8.2f} {file}: {name}")
        return 0
    times = {} if options.counts else {place: way(False) for place, way in ways.items()}
    found = {
        place: {kind: counts_of(some) for kind, some in kinds.items()}
        for place, kinds in walks.items()
    }
    limits = found if options.update else json.loads(COMMITTED.read_text())
    print("\n".join(table(found, limits, times)))
    if options.update:
        places = (
            f' "{place}": {{\n' + ",\n".join(
                f'  "{kind}": {counts}' for kind, counts in kinds.items()
                if kind not in _VARIES.get(place, ())
            ) + "\n }" for place, kinds in found.items()
        )
        COMMITTED.write_text("{\n" + ",\n".join(places) + "\n}\n")
    return int(exceeded(found, limits))


if __name__ == "__main__":
    raise SystemExit(main())
