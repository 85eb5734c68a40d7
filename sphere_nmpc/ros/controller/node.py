# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller node: rolls the sphere to a goal position and orientation.

subscribes  pose, goal_pose, goal_point, goals, path, map, keepout, joint_states while commands
            are late or lost
publishes   rotor_trajectory, rotor_commands, control_period, ~/active_goal, ~/at_goal, ~/eta,
            ~/floor, ~/path, ~/predicted_path, ~/status, /diagnostics
services    ~/enable, ~/cancel
"""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial

from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.timer import Timer
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.goal_memory import goal_memory
from sphere_nmpc.control.schedule import LockstepSchedule, PlanRequest, Schedule, TimedPose
from sphere_nmpc.errors import InvalidValueError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.cdr import Pose, fields, pose_in_frame
from sphere_nmpc.ros.control_clock import ClockedNode, ControlClock
from sphere_nmpc.ros.controller.command_sender import CommandSender
from sphere_nmpc.ros.controller.goal_receiver import GoalReceiver
from sphere_nmpc.ros.controller.monitor import ControllerMonitor
from sphere_nmpc.ros.controller.reports import ControllerReports
from sphere_nmpc.ros.controller.rotor_receiver import RotorReceiver
from sphere_nmpc.ros.floor_receiver import FloorReceiver, floor_with_distances
from sphere_nmpc.ros.graph_monitor import NO_EVENTS
from sphere_nmpc.ros.guarded_node import LATCHED, NEWEST
from sphere_nmpc.ros.input_monitor import CHECK_EVERY
from sphere_nmpc.ros.lifetime import run
from sphere_nmpc.ros.settings import ControllerNodeSettings, FrameSettings, SchedulingSettings
from sphere_nmpc.ros.stored import SAVE_EVERY, Stored
from sphere_nmpc.settings import STRATEGIES
from sphere_nmpc.worker.process import WorkerProcess

_FOUND_EVERY = 4e-3
"""Wall time between two looks for the plan of a search, while one is under way [s]."""
_SELDOM = 0.05
"""Control period above which a command that may be lost is sent again before the next one [s]."""
_GOAL_LOGGED_EVERY = 0.1
"""Least wall time between two reports of one goal that is given again and again [s]."""


class ControllerNode(ClockedNode):
    """Node that passes messages to a `Schedule` and a `Controller`, and publishes commands."""

    uses_events_executor = True

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("controller", parameter_overrides)
        declare = self.parameters.declare
        robot = declare(RobotParameters(), "robot").settings
        settings = self._settings = declare(
            ControllerNodeSettings().of(robot), on_change=self._change, prepare=self._prepare
        ).settings
        self._period = settings.control_period
        self._scheduling = declare(SchedulingSettings())
        self._frame = declare(FrameSettings()).settings.world_frame
        floor = declare(
            FloorSettings(), prepare=lambda *change: self._floor_receiver.prepare(*change)
        ).settings
        self.parameters.warn_of_unknown()
        self.add_on_set_parameters_callback(self._refuse)
        self._control_clock = ControlClock(self, self._clock_jumped, not settings.lockstep)
        schedule = LockstepSchedule if settings.lockstep else Schedule
        self._schedule = schedule(settings, self._control_clock.watch)
        # Before anything is planned, and before there is a process that would have to be ended.
        self._floor_receiver = FloorReceiver(
            self, floor, robot.shell_radius, self._frame,
            partial(floor_with_distances, robot.shell_radius), self._use_floor, self._fault_log,
            self._event_log,
        )
        self.resources.callback(self._floor_receiver.close)
        self._worker: WorkerProcess | None = None
        if self._schedule.is_real_time:
            self._worker = WorkerProcess(lambda line: self._fault_log.report("worker", line))
            self.resources.callback(self._worker.close)
        self.controller = Controller(settings, robot, worker=self._worker)
        self.controller.floor = self._floor_receiver.floor
        self._monitor = ControllerMonitor(self, self._fault_log)
        self._goal_logged_at = -math.inf
        self._stored_goal = Stored(
            self, goal_memory, settings.goal_memory, self._control_clock, self._fault_log, "goal",
            "without a goal",
        )
        # Before the publisher of commands, so that nobody finds that one alone.
        self._period_publisher = self.create_publisher(Float64, "control_period", LATCHED)
        self._period_publisher.publish(Float64(data=settings.control_period))
        self._sender = CommandSender(
            self, settings.command_rate, self._control_clock.steady_now,
            depth=1 if self._schedule.is_real_time else 10,
        )
        self._reports = ControllerReports(
            self, self._control_clock.stamp, self.controller, self._schedule, self._fault_log,
            robot, settings, self._monitor, self._event_log, self._frame,
            lambda: self._floor_receiver.pending,
        )
        self._rotor_receiver = RotorReceiver(
            self, self.controller, self._control_clock
        ) if self._schedule.is_real_time else None
        self._subscribe(robot.shell_radius)
        self._timer: Timer | None = None
        self._set_timer()
        self.create_wall_timer(CHECK_EVERY, self._check)
        self.create_wall_timer(SAVE_EVERY, self._save_goal)
        self._found_timer = self.create_wall_timer(_FOUND_EVERY, self._use_found)
        self._found_timer.cancel()

    @property
    def thread_priority(self) -> int:
        """Real-time priority as set, and none in lockstep, where time waits for this node."""
        return self._scheduling.settings.thread_priority if self._schedule.is_real_time else 0

    def finish(self) -> None:
        """Send a stop, on both command topics."""
        now = self._control_clock.final_now()
        self._save_goal()
        self.controller.enabled = False
        if now is not None:
            self._plan(self._schedule.request(now))
            self._sender.send_final_ramp(now)
        self._stored_goal.close()

    def _subscribe(self, radius: float) -> None:
        # In lockstep the pose of a sampling instant must not get lost; it is the last one before
        # simulated time stops, so that a depth of one keeps it.
        newest = NEWEST if self._schedule.is_real_time else 1
        self.create_subscription(
            PoseStamped, "pose", self._receive_pose, newest, event_callbacks=NO_EVENTS, raw=True
        )
        self.create_service(SetBool, "~/enable", self._enable)
        self.create_service(Trigger, "~/cancel", self._cancel)
        self._goal_receiver = GoalReceiver(
            self, self._control_clock, self._frame, radius, lambda: self._settings,
            self._set_goals, self._fault_log,
        )

    def _set_timer(self) -> None:
        """Replace the timer by one with the period of the schedule, if it needs one."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
        period = self._schedule.timer_period
        self._timer = None if period is None else self.create_timer(period, self._tick)

    def _check(self) -> None:
        clock = self._control_clock
        now, watch = clock.now(), clock.watch
        jump = 0.0 if watch.is_steady else watch.step
        if now is not None:
            has_goal = self.controller.active is not None  # else nothing is to move
            deviation = self.controller.estimator.stamp_deviation if has_goal else 0.0
            self._monitor.poses.moved(now, deviation)
            newest = self.controller.estimator.newest
            if newest is not None and self._schedule.is_overdue(
                now - newest[0], bool(self._monitor.poses.reported)
            ):
                self._plan(self._schedule.request(now))
        self._monitor.check(
            now, clock.simulated, jump, self._settings.pose_timeout,
            (*self.controller.faults, *self._floor_receiver.faults()),
            (self._reports.ticks, self._schedule.missed, self._period),
        )
        self._reports.update()
        if self._rotor_receiver is not None:
            self._rotor_receiver.update()
        self._event_log.flush()
        restored = self._stored_goal.restore()
        if restored is not None:
            goals, age = restored
            self.get_logger().info(f"continuing to the goal of {age:.0f} s ago (goal_memory)")
            self._set_goals(goals)

    def _save_goal(self) -> None:
        active = self.controller.active if self.controller.enabled else None
        # A path may have as many places as would take seconds to be written.
        self._stored_goal.save(None if active is not None and active.course.paths else active)

    def _tick(self) -> None:
        now = self._control_clock.steady_now()
        if now is not None:
            self._schedule.window = self.controller.link.window
            self._plan_instant(now)

    def _plan_instant(self, now: float) -> None:
        """Plan for the sampling instant that is due at control time `now` [s]."""
        schedule, pose = self._schedule, self._schedule.kept
        if pose is not None:
            if schedule.is_ahead(pose, now):
                self._monitor.pose_refused(pose.time - now, self._settings.pose_timeout)
            else:
                self.controller.observe(pose.time, pose.state)
        self._plan(schedule.tick(now))

    def _start(self, now: float | None) -> bool:
        """Plan immediately if the rotors are at rest and there is a goal to start for.

        `now` is control time [s], None where it is not known. Return whether a plan was made.
        """
        if now is None or not self._schedule.may_start or not self.controller.awaits_start(now):
            return False
        self._restart(now)
        return True

    def _restart(self, now: float) -> None:
        """Plan immediately, which begins a new grid of sampling instants."""
        if self._timer is not None:
            self._timer.reset()
        self._schedule.restart()
        self._plan_instant(now)

    def _stop(self) -> None:
        """Plan a stop immediately, rather than at the next sampling instant."""
        now = self._control_clock.steady_now()
        if now is not None and self._schedule.is_real_time:
            self._plan(self._schedule.request(now))

    def _plan(self, request: PlanRequest) -> None:
        began, schedule, epoch = time.perf_counter(), self._schedule, self._control_clock.epoch
        controller = self.controller
        decision = controller.decide(request.instant, request.time_budget)
        starts = schedule.command_time(request, time.perf_counter() - began)
        hold = controller.commit(decision, starts) or schedule.answer(request)
        if hold is not None:
            seldom = schedule.is_real_time and self._period > _SELDOM
            repeated = seldom and controller.link.is_apparent
            self._sender.send(hold, epoch, repeated)
        ended = time.perf_counter()
        schedule.completed(ended - began, decision.solved)
        self._reports.tick(decision, request.instant, ended - began, ended, epoch)
        between = self._period > _FOUND_EVERY
        if between and controller.planner.searches and self._found_timer.is_canceled():
            self._found_timer.reset()

    def _use_found(self) -> None:
        """Plan immediately when a search has ended, rather than at the next sampling instant."""
        now = self._control_clock.steady_now()
        if now is not None and self.controller.planner.is_due(now + self._schedule.window):
            self._restart(now)
        if not self.controller.planner.searches:
            self._found_timer.cancel()

    def _receive_pose(self, message: bytes) -> None:
        schedule = self._schedule
        now = self._control_clock.steady_now() if schedule.is_real_time else None
        try:
            stamp, frame, numbers = fields(message, Pose)
            measured = self._control_clock.time_of(stamp)
            age = math.nan if now is None else now - measured
            self._monitor.poses.heard(age, stamp)
            self.controller.link.pose_received(measured, age)
            pose = TimedPose(stamp, measured, pose_in_frame(numbers, frame, self._frame))
            self._monitor.poses.received(measured, pose.state)
        except InvalidValueError as error:
            self._fault_log.report("pose refused", str(error))
            return
        if stamp == schedule.answered:
            self._sender.repeat()
        elif schedule.pose_received(pose, now):
            self.controller.observe(pose.time, pose.state)
            if not schedule.is_real_time:
                self._plan(schedule.request(pose.time))
            elif schedule.starting:
                self._start(now)

    def _use_floor(self, floor: Floor | None) -> None:
        self.controller.floor = floor

    def _set_goals(self, goals: ActiveCourse) -> None:
        """Follow a course; one that is in force already is only confirmed."""
        clock, wall = self._control_clock, time.monotonic()
        now = clock.steady_now()
        given = None if now is None else clock.own_time(goals.stamp, now)
        is_new = self.controller.following.take(goals, now if given is None else given)
        self._stored_goal.is_settled = True
        if not is_new and wall < self._goal_logged_at + _GOAL_LOGGED_EVERY:
            return
        self._goal_logged_at = wall
        self._reports.goal(clock.stamp(), is_new)
        if not is_new:
            return
        self._schedule.goal_changed()
        if not self._start(now):
            self._reports.present()
        self._save_goal()
        number, paths = len(goals.course.legs), goals.course.paths
        several = f"first of {number}: " if number > 1 else ""
        along = f"{paths[0].length:.2f} m along a path to " if paths else ""
        self._event_log.report("goal", f"{several}{along}{goals.goal}")

    def _cancel(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        was_in_force = self.controller.cancel()
        self._stored_goal.is_settled = True
        self._save_goal()
        self._stop()
        response.success = True
        response.message = (
            "cancelled, the sphere stops" if was_in_force else "no goal was in force"
        )
        self._event_log.report("cancel", response.message)
        return response

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.controller.enabled = request.data
        if request.data:
            self._schedule.goal_changed()
        else:
            self._stop()
        response.success = True
        response.message = "enabled" if request.data else "disabled, the sphere stops"
        self._event_log.report("enable", response.message)
        return response

    def _change(self, settings: ControllerNodeSettings) -> None:
        if settings.control_period != self._period:
            self._period = settings.control_period
            self._period_publisher.publish(Float64(data=self._period))
        if settings.strategy != self._settings.strategy:
            self._event_log.report("strategy", settings.strategy)
        self._settings, period = settings, self._schedule.timer_period
        self.controller.change(settings)
        self._reports.change(settings)
        self._schedule.change(settings)
        if self._schedule.timer_period != period:
            self._set_timer()

    def _prepare(
        self, settings: Callable[[], ControllerNodeSettings], names: set[str], is_awaited: bool
    ) -> Future[Callable[[], object]]:
        """Make the strategy of settings that are to be set, where it is another one."""
        made: Future[Callable[[], object]] = Future()
        try:
            self.controller.prepare(settings())
        except Exception as error:
            made.set_exception(error)
        else:
            made.set_result(lambda: None)
        return made

    def _refuse(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse a strategy that the schedule cannot change to."""
        for name in (p.value for p in parameters if p.name == "strategy"):
            if name in STRATEGIES:  # another name is refused by its declaration
                reason = self._schedule.refusal(replace(self._settings, strategy=name))
                if reason is not None:
                    return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _clock_jumped(self, changed: bool) -> None:
        """Send nothing while the clock jumps; then go on, or begin anew at another time."""
        watch = self._control_clock.watch
        if not watch.is_steady:
            if self._monitor.is_steady:
                self._check()  # to be reported at once, and not at each of many jumps
            return
        if not watch.has_returned:
            self._event_log.report(
                "clock", f"{'changed' if changed else 'runs on'} at another time; poses and plans "
                "are dropped, the goal stays",
            )
            self.controller.forget()
            self._sender.forget()
        self._schedule.clock_jumped(watch)
        self._set_timer()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(ControllerNode, args, __doc__ or "")
