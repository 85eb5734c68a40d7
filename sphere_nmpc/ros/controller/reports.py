# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of the controller's goal, path, arrival, prediction, status and diagnostics."""

import math
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import Bool, Float64

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.monitors import rotor_reserve
from sphere_nmpc.control.schedule import Schedule
from sphere_nmpc.control.status import ControllerStatus, goals_in_force
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import Vector
from sphere_nmpc.reporting.conditions import (
    ERROR,
    OK,
    WARN,
    Condition,
    Kind,
    Report,
    with_conditions,
    worst_first,
)
from sphere_nmpc.reporting.fault_log import FaultLog, LastingFaults
from sphere_nmpc.reporting.recent import Recent
from sphere_nmpc.ros.cdr import stamp_of
from sphere_nmpc.ros.controller.monitor import ControllerMonitor
from sphere_nmpc.ros.diagnostics import Diagnostics
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode
from sphere_nmpc.ros.messages import path_to_ros, pose_to_ros
from sphere_nmpc.settings import ControllerSettings

_KEPT = 1000
"""Newest plans whose durations the percentiles are taken of."""
_STATUS_EVERY = 0.0499
"""Shortest control time between two statuses of the same mode [s]: 20 Hz."""
_EACH = 10
"""Which places of a path are published, of 60 for each radius of its length."""
_LONGEST_SILENCE = 0.4
"""Wall time after which a status is published also where there was no sampling instant [s]."""


class ControllerReports:
    """Publisher of goal, arrival, path, status and diagnostics, in `frame`.

    `now` returns the present stamp [ns], `floor_pending` for how long a change of the floor has
    not been in force [s].
    """

    def __init__(
        self,
        node: GuardedNode,
        now: Callable[[], int],
        controller: Controller,
        schedule: Schedule,
        fault_log: FaultLog,
        robot: RobotParameters,
        settings: ControllerSettings,
        monitor: ControllerMonitor,
        event_log: FaultLog,
        frame: str,
        floor_pending: Callable[[], float],
    ) -> None:
        self._controller = controller
        self._floor_pending = floor_pending
        self._monitor = monitor
        self._schedule = schedule
        self._fault_log = fault_log
        self._event_log = event_log
        self._robot = robot
        self._frame = frame
        self._period = settings.control_period
        self._strategy = settings.strategy
        self._status_values = ControllerStatus(controller, robot, settings)
        self._solve_times, self._tick_times = Recent(_KEPT), Recent(_KEPT)
        self._gaps = Recent(_KEPT)
        self._decision: Decision | None = None
        self._is_outdated = False
        """Whether the decision is about an earlier goal."""
        self.ticks = self._ticks_reported = 0
        """Sampling instants since the start."""
        self._lasting = LastingFaults(fault_log, lambda line: node.get_logger().info(line))
        self._last_tick = float("nan")
        self._last_status = (float("-inf"), Kind.NO_POSE)
        self._goal = node.create_publisher(PoseStamped, "~/active_goal", LATCHED)
        self._at_goal = node.create_publisher(Bool, "~/at_goal", LATCHED)
        self._at_goal_published: bool | None = None
        self._published_index = self._active_goal = 0
        self._eta = node.create_publisher(Float64, "~/eta", 10)
        self._path = node.create_publisher(PathMessage, "~/path", LATCHED)
        self._paths: tuple[Path, ...] | None = None
        self._prediction = node.create_publisher(PathMessage, "~/predicted_path", 10)
        self._values: dict[str, Any] = {}
        self._warnings: tuple[Condition, ...] = ()
        """Warnings of the last status, the worst first."""
        self._plan_message = Kind.NO_POSE.value
        """Message of a status without a warning: its mode, and what is said of the plan."""
        self._status_at = perf_counter()
        self._diagnostics = Diagnostics(
            node, now, {"solver": self._solver, "loop": self._loop}, status=10
        )
        self._publish_arrival()
        self._publish_path()

    def goal(self, stamp: int, is_new: bool = True) -> None:
        """Publish the goal that is aimed at from now on, `stamp` [ns]; the next status is due.

        One that is not new has been in force before.
        """
        active = self._controller.active
        if active is not None:
            self._published_index, self._active_goal = active.index, stamp
            self._goal.publish(
                pose_to_ros(active.goal.pose, stamp, self._robot.shell_radius, self._frame)
            )
        self._last_status = (float("-inf"), self._last_status[1])
        if is_new:
            self._publish_path()
            self._is_outdated, self._warnings = True, ()
        self._publish_arrival()

    def _publish_path(self) -> None:
        """Publish the path that is followed if it is another one than before, empty for none."""
        active = self._controller.active
        paths = () if active is None else active.course.paths
        if paths == self._paths:
            return
        self._paths = paths
        states = np.vstack([np.empty((0, 6)), *map(_shown, paths)])
        self._path.publish(path_to_ros(
            np.zeros(len(states)), states, self._robot.shell_radius,
            0 if active is None else active.stamp, self._frame,
        ))

    def _publish_progress(self, time: float, epoch: int) -> None:
        """Publish the next goal of a list if the one before has been reached."""
        active = self._controller.active
        if active is None or active.index == self._published_index:
            return
        count = len(active.course.legs)
        self._event_log.report("goal", f"{active.index} of {count} reached")
        self.goal(stamp_of(time, epoch), is_new=False)

    @property
    def _mode(self) -> Kind:
        """Mode at present, also between sampling instants."""
        if math.isnan(self._monitor.time):
            return Kind.NO_CLOCK
        if self._monitor.stands_still:
            return Kind.CLOCK_STOPPED
        if not self._monitor.is_steady:
            return Kind.CLOCK_JUMPED
        decision, controller = self._decision, self._controller
        if decision is None:
            return Kind.NO_POSE
        mode = decision.mode
        if decision.solved or mode is Kind.NO_GOAL:
            if controller.active is None:
                return Kind.NO_GOAL
            is_past = mode is Kind.NO_PROGRESS and self._is_outdated
            if is_past or (mode is Kind.AT_GOAL and not controller.at_goal):
                return Kind.TRACKING
        return mode

    def update(self) -> None:
        """Publish what has changed, and a status if there was none for a while.

        Call it after each check.
        """
        self._publish_arrival()
        self._publish_path()
        if perf_counter() - self._status_at >= _LONGEST_SILENCE:
            self.present()

    def present(self) -> None:
        """Publish a status between sampling instants.

        After a new goal, so that each is shown, also one that is replaced before the next instant.
        """
        mode, time = self._mode, self._monitor.time
        # Nothing was solved since: the last solve time must not be counted again.
        values: dict[str, Any] = {"time_s": f"{time:.9g}", "strategy": self._strategy}
        values |= self._values | {"mode": mode.value, "solve_time_s": 0.0}
        if self._decision is None or self._is_outdated or mode is not self._decision.mode:
            values |= self._status_values.goal_values(None, time)
            values |= {"giving_up": "", "unreachable": "", "no_progress": ""}
        values["at_rest"] = not math.isnan(time) and self._controller.is_at_rest(time)
        is_same = mode is self._last_status[1] and not self._is_outdated
        message = self._plan_message if is_same else mode.value
        self._publish_status(mode, self._warnings if is_same else (), message, values)

    def _publish_status(
        self, mode: Kind, warnings: Sequence[Condition], message: str, values: dict[str, Any]
    ) -> None:
        """Publish a status; the worst fault or warning takes precedence over `message`."""
        self._status_at = perf_counter()
        values = {
            **values, **goals_in_force(self._controller.active, self._active_goal),
            "floor_pending_s": self._floor_pending(),
            "pose_topic": self._monitor.topic,
        }
        found = worst_first((*self._monitor.graph.faults, *warnings))
        report: Report = mode.severity, message, values
        if found:
            report = with_conditions(report, found)
        self._diagnostics.status.publish(self._diagnostics.message(report))

    def _publish_arrival(self) -> None:
        if self._controller.at_goal is not self._at_goal_published:
            self._at_goal_published = self._controller.at_goal
            self._at_goal.publish(Bool(data=self._at_goal_published))
            if self._at_goal_published and self._decision is not None:
                took, error = self._controller.following.arrival.took, self._decision.error
                self._event_log.report(
                    "arrival", f"at the goal after {took:.2f} s, error {error:.1g}"
                )

    def change(self, settings: ControllerSettings) -> None:
        """Apply settings that may change while running."""
        if settings.strategy != self._strategy:
            for times in (self._solve_times, self._tick_times, self._gaps):
                times.clear()
        self._period, self._strategy = settings.control_period, settings.strategy
        self._status_values.change(settings)

    def tick(
        self, decision: Decision, time: float, duration: float, wall: float, epoch: int
    ) -> None:
        """Record the decision for the instant `time` [s], which took `duration` until `wall` [s].

        At a high control rate not every instant is published, to save time for the control loop,
        and what is only published or logged is not computed for the others. `epoch` is the stamp
        of control time 0 [ns].
        """
        self.ticks += 1
        self._decision, self._is_outdated = decision, False
        self._tick_times.append(duration)
        self._gaps.append(wall - self._last_tick)
        self._last_tick = wall
        plan, solved, mode = decision.plan, decision.solved, decision.conditions[0].kind
        if solved:
            if decision.is_new:
                self._solve_times.append(plan.made.solve_time)
        elif mode is Kind.FALLBACK:
            self._fault_log.report(Kind.FALLBACK.log, plan.message)
        self._status_values.update(decision, time)
        self._publish_progress(time, epoch)
        self._publish_arrival()
        last, before = self._last_status
        if mode is before and 0.0 <= time - last < _STATUS_EVERY:
            return
        self._last_status = (time, mode)
        self._log_failures(mode)
        self._warnings = warnings = self._find_warnings(decision)
        self._lasting.update({one.name: one.text for one in warnings} if solved else {})
        self._values = self._status_values.values(decision, time, duration, self._schedule.missed)
        about = plan.message
        is_all = mode is Kind.AT_GOAL or about in ("", mode.value)
        self._plan_message = mode.value if is_all else f"{mode.value}: {about}"
        self._publish_status(mode, warnings, self._plan_message, self._values)
        self._eta.publish(Float64(data=float(self._values["time_left_s"])))
        # Making the path takes as long as a plan.
        if len(plan.states) and self._prediction.get_subscription_count() > 0:
            times, radius = plan.hold.times, self._robot.shell_radius
            self._prediction.publish(path_to_ros(times, plan.states, radius, epoch, self._frame))

    def _log_failures(self, mode: Kind) -> None:
        """Log what has failed since the last status, but for solves: a pose or a command."""
        log, controller, gate = self._fault_log, self._controller, self._controller.pose_gate
        for kind, count, text in (
            (Kind.CONTROLLER_FAILED, controller.failures, controller.last_failure),
            (Kind.POSE_JUMPED, gate.jumps, gate.last_jump),
            (Kind.POSE_LEFT_OUT, gate.outliers, gate.last_outlier),
        ):
            is_reported = kind is Kind.CONTROLLER_FAILED and mode is Kind.FALLBACK
            if log.has_risen(kind.log, count) and not is_reported:
                log.report(kind.log, text)

    def _find_warnings(self, decision: Decision) -> tuple[Condition, ...]:
        """Return what keeps the sphere from its goal, or will soon; the worst first."""
        found = [one for one in decision.conditions if one.text]
        if decision.solved and decision.goal is not None:
            rotors = rotor_reserve(
                decision.momentum, decision.disturbance, self._robot, decision.goal
            )
            found = [rotors, *found] if rotors else found
        return worst_first(found)

    def _solver(self) -> Report:
        """Return the diagnostics about solve times and failures."""
        median, p99, most = _percentiles(self._solve_times)
        values = {
            "strategy": self._strategy,
            "median ms": median,
            "p99 ms": p99,
            "max ms": most,
            "failures": self._controller.failures,
        }
        if self._decision is not None and self._decision.mode is Kind.FALLBACK:
            return ERROR, self._decision.plan.message, values
        if p99 > self._period * 1e3:
            return WARN, "solving takes longer than the control period", values
        return OK, "solving" if self._solve_times else "nothing solved yet", values

    def _loop(self) -> Report:
        """Return the diagnostics about ticks and the pose's age."""
        ticks = self.ticks - self._ticks_reported
        self._ticks_reported = self.ticks
        decision = self._decision
        tick_ms, gap_ms = _percentiles(self._tick_times), _percentiles(self._gaps)
        values = {
            "ticks since last report": ticks,
            "control period s": self._period,
            "wall period median ms": gap_ms[0],
            "wall period p99 ms": gap_ms[1],
            "tick median ms": tick_ms[0],
            "tick p99 ms": tick_ms[1],
            "missed ticks": self._schedule.missed,
            "late poses": self._controller.late_poses,
            "poses left out": self._controller.pose_gate.outliers,
            "pose age s": float("inf") if decision is None else decision.pose_age,
            **self._fault_log.counts,
        }
        mode = self._mode
        at = f" at {self._monitor.time:.3f} s" if mode is Kind.CLOCK_STOPPED else ""
        found = [one._replace(text="") for one in self._monitor.graph.faults]
        return with_conditions((mode.severity, f"{mode.value}{at}", values), found)


def _shown(path: Path) -> Vector:
    """Return places of a path with its heading there, upright, shape (K, 6)."""
    curve = np.vstack((path.curve[:-1:_EACH], path.curve[-1]))
    half, none = 0.5 * curve[:, 2], np.zeros(len(curve))
    return np.column_stack((curve[:, :2], np.cos(half), none, none, np.sin(half)))


def _percentiles(times: Recent) -> tuple[float, float, float]:
    """Return median, 99th percentile and maximum of times [s] in ms; nan where there are none."""
    median, p99, most = (1e3 * times.quantile(share) for share in (0.5, 0.99, 1.0))
    return median, p99, most
