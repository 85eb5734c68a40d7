# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Length of the way through the code: calls, functions, files and records of an instant.

Case 1 is rolled in a closed loop without ROS, and between controller node and simulator over DDS.
Counted are calls into sphere_nmpc, distinct functions and files among them, and kinds of its
records that are made; in the node without what is within the controller, which depends on the
load. Figures are medians. Times are taken in a second pass, in thousands of additions of small
NumPy arrays. The exit status is 1 where a count exceeds that of walk.json.
"""

import argparse
import contextlib
import itertools
import json
import math
import os
import sys
import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from statistics import median, median_low
from types import FrameType
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

import sphere_nmpc
from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.link import REACH
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import floor_message
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
NEARLY = "tick, solved near the end"
FOLLOWED, RESTING, SOLVED = "tick, followed", "tick, resting", "tick, solved"
REPORTED = "tick, with a status"
_VARIES = {"loop": (SOLVED, NEARLY), "node": (SOLVED, NEARLY, REPORTED)}
"""Not committed: searches in line depend on the last digits, and what is told on the load."""
COUNTS = "calls", "functions", "files", "records"
PATIENCE = 120.0
"""How long the nodes may take on a busy machine [s]."""
_ROOT = os.path.dirname(sphere_nmpc.__file__) + os.sep
_INLINED = "<listcomp>", "<setcomp>", "<dictcomp>"
"""Frames that not every version of Python makes."""
_PERIOD = 0.01
"""Control period [s]: a status is due at each fifth instant."""
_DURATION = 7.0
"""Time of the closed loop [s], which arrives in it."""
_LATE = 3
"""Instants that a worker takes for a task in the loop without ROS."""
_AWAITED = 0.05
"""How long time waits for the controller's tick and for its worker at an instant [s, wall]."""
_READING = 2e-4
"""Time between two readings of the clock of durations [s], where calls are counted."""
_GOALS, _KNOWN_GOALS, _MAPS = 9, 9, 3
_BETWEEN = 0.15
"""Wall time between two known goals [s]: each is told."""
_START, _GOAL = PAPER_CASES[1].start, PAPER_CASES[1].goal


@dataclass
class Walk:
    """Calls and records of one instant, and the time that it took [thousands of operations]."""

    calls: list[tuple[str, str]] = field(default_factory=list)
    records: set[str] = field(default_factory=set)
    time: float = 0.0


class Meter:
    """Recorder of walks, by calls or by time, each sorted by its kind when it is over.

    The walk to a first decision ends with it, within a callback.
    """

    def __init__(self, counts: bool) -> None:
        self._counts = counts
        self._now = Walk()
        self._cut_at: float | None = None
        self._cuts = False
        self._makers: set[FrameType] = set()
        self.decision: Any = None
        """The newest decision in the present walk."""
        self.walks: dict[str, list[Walk]] = defaultdict(list)
        self._unit = _operations()

    def of(self, controller: Controller) -> None:
        """Take note of the decisions of a node's controller."""
        def note(decision: Decision) -> None:
            self.decision = decision
            if self._cuts:
                sys.setprofile(None)
                self._cut_at = time.perf_counter()

        _after(controller, "decide", note)

    def run(self, function: Callable[..., Any], *arguments: Any, cuts: bool = False) -> Any:
        """Call a function as part of the present walk, which ends at a decision with `cuts`."""
        self._cuts, self._cut_at = cuts, None
        if self._counts:
            threading.setprofile(self._record)
            sys.setprofile(self._record)
        self._makers.clear()
        began = time.perf_counter()
        try:
            return function(*arguments)
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
            self._now.time += ((self._cut_at or time.perf_counter()) - began) / self._unit

    def note(self, kind: str) -> None:
        """Count what there is of the present walk as one of this kind; it goes on."""
        self.walks[kind].append(deepcopy(self._now))

    def end(self, kind: str | None) -> None:
        """End the present walk, which is of this kind; None forgets it."""
        if kind == FOLLOWED and any(file == "ros/diagnostics.py" for file, _ in self._now.calls):
            kind = REPORTED
        if kind is not None:
            self.walks[kind].append(self._now)
            if len(self.walks[kind]) % 50 == 0:
                self._unit = _operations()
        self._now, self.decision = Walk(), None

    def end_tick(self) -> None:
        """End the walk of a sampling instant."""
        decision, kind = self.decision, None
        if decision is not None and decision.mode is Kind.AT_GOAL:
            kind = RESTING
        elif decision is not None and decision.mode is Kind.TRACKING:
            kind = SOLVED if decision.is_new else FOLLOWED
            hold = decision.plan.hold
            if kind == SOLVED and hold.end - hold.start < REACH:
                kind = NEARLY
        self.end(kind)

    def take(self, other: "Meter") -> None:
        """Append the present walk of another meter to that of this one."""
        self._now.calls += other._now.calls
        self._now.records |= other._now.records
        self._now.time += other._now.time

    def _record(self, frame: FrameType, event: str, argument: Any) -> None:
        """Count a call, and what a function makes: by `__init__`, or by `__new__` and returned."""
        code = frame.f_code
        if event == "call":
            if code.co_filename.startswith(_ROOT) and code.co_name not in _INLINED:
                name = getattr(code, "co_qualname", code.co_name)  # from Python 3.11 on
                self._now.calls.append((code.co_filename[len(_ROOT):], name))
            if code.co_name == "__init__":
                self._made(frame.f_locals.get(code.co_varnames[0]))
        elif event == "c_call":
            if getattr(argument, "__name__", "") == "__new__":
                self._makers.add(frame)
        elif event == "return" and frame in self._makers:
            self._makers.remove(frame)
            self._made(argument)

    def _made(self, value: Any) -> None:
        """Count a value if it is a record of the package."""
        made = type(value)
        is_record = is_dataclass(made) or (issubclass(made, tuple) and hasattr(made, "_fields"))
        if is_record and made.__module__.startswith(sphere_nmpc.__name__):
            self._now.records.add(made.__name__)


def _operations() -> float:
    """Return the time of a thousand additions of small arrays [s]."""
    one, other = np.arange(9.0), np.ones(9)
    began = time.perf_counter()
    for _ in range(200):
        one + other
    return 5.0 * (time.perf_counter() - began)


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
    run_closed_loop(simulator, Walked(settings, robot, worker=worker), _GOAL, _DURATION, _PERIOD)
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
        _after(self._controller, "commit", self._sent)
        _after(self._node._worker, "submit", self._replies.append)
        _after(topics_of(self._simulator)["/rotor_trajectory"], "callback", self._arrived)
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
        self._node._worker.poll()
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
            ticks = self._ticks
            self._simulator.work(self)  # type: ignore[arg-type]
            awaited = time.monotonic() + _AWAITED
            while time.monotonic() < awaited and (
                self._ticks == ticks or self._is_on_its_way or self._worker_is_busy()
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


def _after(owner: Any, name: str, then: Callable[[Any], object]) -> None:
    """Have a function called with each result of a method of an object."""
    method = getattr(owner, name)

    def call(*arguments: Any) -> Any:
        result = method(*arguments)
        then(result)
        return result

    setattr(owner, name, call)


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


def counts_of(walks: list[Walk]) -> list[int]:
    """Return the numbers of calls, functions, files and kinds of records of a typical instant.

    Of each function it has the median number of calls, and of records those of most instants.
    """
    calls = _medians([walk.calls for walk in walks])
    records = _medians([walk.records for walk in walks])
    return [sum(calls.values()), len(calls), len({file for file, _ in calls}), len(records)]


def _medians(walks: Sequence[Iterable[Any]]) -> dict[Any, int]:
    """Return what is in most of these walks, with the median of how often it is in one."""
    counts = [Counter(walk) for walk in walks]
    found = {one: median_low(count[one] for count in counts) for one in set().union(*counts)}
    return {one: number for one, number in found.items() if number}


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
