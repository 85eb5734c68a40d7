# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of the controller's goal, arrival, predicted path, status and diagnostics."""

import math
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from std_msgs.msg import Bool, Float64

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision, Mode
from sphere_nmpc.control.monitors import rotor_reserve
from sphere_nmpc.control.recent import Recent
from sphere_nmpc.control.schedule import Schedule
from sphere_nmpc.fault_log import FaultLog, LastingFaults
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.controller.monitor import ControllerMonitor
from sphere_nmpc.ros.controller.status import ControllerStatus, goals_in_force
from sphere_nmpc.ros.diagnostics import ERROR, OK, STALE, WARN, status, status_name
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import path_to_ros, pose_to_ros, stamp_of
from sphere_nmpc.settings import ControllerSettings

_LEVELS = {
    Mode.TRACKING: OK,
    Mode.AT_GOAL: OK,
    Mode.NO_PROGRESS: WARN,
    Mode.SATURATED: ERROR,
    Mode.NO_GOAL: OK,
    Mode.NO_CLOCK: STALE,
    Mode.CLOCK_STOPPED: WARN,
    Mode.CLOCK_JUMPED: WARN,
    Mode.DISABLED: OK,
    Mode.NO_POSE: STALE,
    Mode.NO_FRESH_POSE: ERROR,
    Mode.POSE_JUMPED: WARN,
    Mode.FALLBACK: WARN,
}
_OF_GOAL = (Mode.NO_GOAL, Mode.TRACKING, Mode.AT_GOAL, Mode.NO_PROGRESS)
"""Modes that depend on the goal."""
_NO_PROGRESS = "no progress"
"""Kind of the fault of a sphere that stands away from its goal."""
_KEPT = 1000
"""Newest plans whose durations the percentiles are taken of."""
_STATUS_EVERY = 0.0499
"""Shortest control time between two statuses of the same mode [s]: 20 Hz."""
_LONGEST_SILENCE = 0.4
"""Wall time after which a status is published also where there was no sampling instant [s]."""


class ControllerReports:
    """Publisher of goal, arrival, path and status, in `frame`; source of the diagnostics.

    `floor_pending` returns for how long a change of the floor has not been in force [s].
    """

    def __init__(
        self,
        node: Node,
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
        self._last_status = (float("-inf"), Mode.NO_POSE)
        self._goal = node.create_publisher(PoseStamped, "~/active_goal", LATCHED)
        self._at_goal = node.create_publisher(Bool, "~/at_goal", LATCHED)
        self._at_goal_published: bool | None = None
        self._published_index = self._active_goal = 0
        self._eta = node.create_publisher(Float64, "~/eta", 10)
        self._path = node.create_publisher(Path, "~/predicted_path", 10)
        self._status = node.create_publisher(DiagnosticStatus, "~/status", 10)
        self._name = status_name(node)
        self._values: dict[str, Any] = {}
        self._message = Mode.NO_POSE.value
        self._warned = False
        self._status_at = perf_counter()
        self._publish_arrival()

    def goal(self, stamp: int, is_new: bool = True) -> None:
        """Publish the goal that is aimed at from now on, `stamp` [ns]; the next status is due.

        One that is not new has been in force before.
        """
        goals = self._controller.goal_sequence
        if goals is not None:
            self._published_index, self._active_goal = goals.index, stamp
            self._goal.publish(
                pose_to_ros(goals.goal.pose, stamp, self._robot.shell_radius, self._frame)
            )
        self._last_status = (float("-inf"), self._last_status[1])
        if is_new:
            self._is_outdated, self._warned = True, False
        self._publish_arrival()

    def _publish_progress(self, time: float, epoch: int) -> bool:
        """Publish the next goal of a list if the one before has been reached; return whether."""
        goals = self._controller.goal_sequence
        if goals is None or goals.index == self._published_index:
            return False
        self._event_log.report("goal", f"{goals.index} of {len(goals.goals)} reached")
        self.goal(stamp_of(time, epoch))
        self.present()
        return True

    @property
    def _mode(self) -> Mode:
        """Mode at present, also between sampling instants."""
        if math.isnan(self._monitor.time):
            return Mode.NO_CLOCK
        if self._monitor.stands_still:
            return Mode.CLOCK_STOPPED
        if not self._monitor.is_steady:
            return Mode.CLOCK_JUMPED
        if self._decision is None:
            return Mode.NO_POSE
        mode, controller = self._decision.mode, self._controller
        if mode in _OF_GOAL:
            if controller.goal_sequence is None:
                return Mode.NO_GOAL
            is_past = mode is Mode.NO_PROGRESS and self._is_outdated
            if is_past or (mode is Mode.AT_GOAL and not controller.at_goal):
                return Mode.TRACKING
        return mode

    def update(self) -> None:
        """Publish a status if there was none for a while; call it after each check."""
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
        message = self._message if is_same else mode.value
        self._publish_status(mode, message, values)

    def _publish_status(self, mode: Mode, message: str, values: dict[str, Any]) -> None:
        """Publish a status; a fault around the node takes precedence over `message`."""
        level, found = max(_LEVELS[mode], WARN if self._warned else OK), self._monitor.faults
        if found:
            message = f"{found[0].kind}: {found[0].message}"
            level = ERROR if found[0].severe else max(level, WARN)
        self._status_at = perf_counter()
        values = {
            **values, **goals_in_force(self._controller.goal_sequence, self._active_goal),
            "floor_pending_s": self._floor_pending(),
            "pose_topic": self._monitor.pose_topic,
        }
        self._status.publish(status(self._name, level, message, values))

    def _publish_arrival(self) -> None:
        if self._controller.at_goal is not self._at_goal_published:
            self._at_goal_published = self._controller.at_goal
            self._at_goal.publish(Bool(data=self._at_goal_published))
            if self._at_goal_published and self._decision is not None:
                took, error = self._controller.arrival_took, self._decision.error
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
        self._tick_times.add(duration)
        self._gaps.add(wall - self._last_tick)
        self._last_tick = wall
        plan, solved = decision.plan, decision.solved
        if solved:
            if decision.is_new:
                self._solve_times.add(plan.solve_time)
        elif decision.mode is Mode.FALLBACK:
            self._fault_log.report("solve failed", plan.message)
        self._status_values.update(decision, time)
        if self._publish_progress(time, epoch):
            return  # the decision is about the goal before
        self._publish_arrival()
        last, mode = self._last_status
        if decision.mode is mode and 0.0 <= time - last < _STATUS_EVERY:
            return
        self._last_status = (time, decision.mode)
        self._log_failures(decision.mode)
        warnings = self._warnings(decision) if solved else {}
        self._lasting.update(warnings)
        self._values = self._status_values.values(decision, time, duration, self._schedule.missed)
        self._message = plan.message or plan.status.value
        if decision.mode is Mode.POSE_JUMPED:
            self._message = f"{decision.mode.value}: {self._controller.pose_gate.last_jump}"
        self._warned = bool(warnings)
        for kind, text in warnings.items():
            self._message = f"{kind}: {text}"
        self._publish_status(decision.mode, self._message, self._values)
        self._eta.publish(Float64(data=float(self._values["time_left_s"])))
        # Making the path takes as long as a plan.
        if len(plan.states) and self._path.get_subscription_count() > 0:
            times, radius = plan.hold.times, self._robot.shell_radius
            self._path.publish(path_to_ros(times, plan.states, radius, epoch, self._frame))

    def _log_failures(self, mode: Mode) -> None:
        """Log what has failed since the last status, but for solves: a pose or a command."""
        log, controller = self._fault_log, self._controller
        if log.has_risen("controller failed", controller.failures) and mode is not Mode.FALLBACK:
            log.report("controller failed", controller.last_failure)
        gate = controller.pose_gate
        if log.has_risen("pose jumped", gate.jumps):
            log.report("pose jumped", gate.last_jump)
        if log.has_risen("pose left out", gate.outliers):
            log.report("pose left out", gate.last_outlier)

    def _warnings(self, decision: Decision) -> dict[str, str]:
        """Return what keeps the sphere from its goal, or will soon, by kind; the worst last."""
        goal = decision.goal
        if goal is None:
            return {}
        missing = {_NO_PROGRESS: decision.no_progress} if decision.no_progress else {}
        return missing | rotor_reserve(
            decision.momentum, decision.disturbance, self._robot, goal
        )

    def solver(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Return level, message and values of the diagnostics about solve times and failures."""
        median, p99, most = _percentiles(self._solve_times)
        values = {
            "strategy": self._strategy,
            "median ms": median,
            "p99 ms": p99,
            "max ms": most,
            "failures": self._controller.failures,
        }
        if self._decision is not None and self._decision.mode is Mode.FALLBACK:
            return ERROR, self._decision.plan.message, values
        if p99 > self._period * 1e3:
            return WARN, "solving takes longer than the control period", values
        return OK, "solving" if self._solve_times else "nothing solved yet", values

    def loop(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Return level, message and values of the diagnostics about ticks and the pose's age."""
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
        mode, found = self._mode, self._monitor.faults
        if found:
            return ERROR if found[0].severe else WARN, found[0].kind, values
        if mode is Mode.CLOCK_STOPPED:
            return WARN, f"{mode.value} at {self._monitor.time:.3f} s", values
        return _LEVELS[mode], mode.value, values


def _percentiles(times: Recent) -> tuple[float, float, float]:
    """Return median, 99th percentile and maximum of times [s] in ms; nan where there are none."""
    median, p99, most = (1e3 * times.quantile(share) for share in (0.5, 0.99, 1.0))
    return median, p99, most
