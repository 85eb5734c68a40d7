# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller node: rolls the sphere to a goal position and orientation.

subscribes  pose, goal_pose
publishes   rotor_trajectory, rotor_commands, ~/active_goal, ~/at_goal, ~/predicted_path,
            ~/status, /diagnostics
services    ~/enable
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockChange, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.goal_memory import GoalMemory
from sphere_nmpc.control.planning_time import PlanningTime
from sphere_nmpc.control.sample_grid import SampleGrid
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.ros.controller.background import Background
from sphere_nmpc.ros.controller.command_sender import CommandSender
from sphere_nmpc.ros.controller.goal_file import goal_file
from sphere_nmpc.ros.controller.reports import ControllerReports
from sphere_nmpc.ros.controller.watch import ControllerWatch
from sphere_nmpc.ros.conversions import (
    NANOSECONDS,
    framed_pose_from_ros,
    seconds,
    stamp_from_ros,
)
from sphere_nmpc.ros.diagnostics import Diagnostics
from sphere_nmpc.ros.lifetime import LivingNode, run
from sphere_nmpc.ros.parameters import DeclaredSettings, warn_of_unknown
from sphere_nmpc.ros.scheduling import SchedulingSettings
from sphere_nmpc.ros.surroundings import OTHER_CLOCK
from sphere_nmpc.ros.watch import NO_EVENTS
from sphere_nmpc.settings import STRATEGIES, ControllerSettings

AT_REST = FirstOrderHold.constant(0.0, np.zeros(INPUT_SIZE))
_CHANGED = (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED)
_LOOK_EVERY = 0.25
"""Wall time between two looks at the surroundings [s]."""
_GOALS_EVERY = 2.0
"""Wall time between two lines about goals [s]; somebody may send them at any rate."""
_REMEMBER_EVERY = 1.0
"""Wall time between two notes of the goal in force [s]."""


class ControllerNode(LivingNode):
    """Tell a `Controller` what the graph says and the graph what it decides.

    Parameters
    ----------
    parameter_overrides : list of Parameter, optional
        As given on a command line; for use within a program.
    """

    lean = True

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__(
            "controller",
            parameter_overrides=parameter_overrides,
            automatically_declare_parameters_from_overrides=True,
        )
        declared = DeclaredSettings(self, ControllerSettings(), on_change=self._change)
        robot = DeclaredSettings(self, RobotParameters(), prefix="robot")
        self._scheduling = DeclaredSettings(self, SchedulingSettings())
        parts = (declared, robot, self._scheduling)
        warn_of_unknown(self, [name for part in parts for name in part.names])
        self.add_on_set_parameters_callback(self._refuse)
        settings = self._settings = declared.settings
        self._faults = FaultLog(lambda line: self.get_logger().warning(line))
        self._goals = FaultLog(lambda line: self.get_logger().info(line), _GOALS_EVERY)
        self._aside = Background(lambda line: self._faults.report("learning failed", line))
        self.controller = Controller(
            settings, robot.settings, aside=None if settings.lockstep else self._aside.do
        )
        self._grid = SampleGrid(settings.control_period)
        self._starting = True
        self._take_clock()
        self._watch = ControllerWatch(self, self._faults)
        self._memory: GoalMemory | None = GoalMemory(goal_file(self), settings.goal_memory)
        self._recalled = False
        self._sender = CommandSender(self, settings.command_rate, self._now)
        self._reports = ControllerReports(
            self, self.controller, self._grid, self._faults, robot.settings, settings, self._watch
        )
        self._answered: int | None = None
        self._ahead: PoseStamped | None = None
        self._listen()
        tasks = {"solver": self._reports.solver, "loop": self._reports.loop}
        self._diagnostics = Diagnostics(self, self._stamp, tasks)

    @property
    def thread_priority(self) -> int:
        """As set, where time does not wait for this node."""
        return 0 if self._settings.lockstep else self._scheduling.settings.thread_priority

    def finish(self) -> None:
        """Send a ramp to rest, on both command topics."""
        now = self._now()
        self._remember()
        self.controller.enabled = False
        if now is not None:
            self._decide(now, now)
        self._sender.farewell()
        self._aside.close()

    def _listen(self) -> None:
        # In lockstep the pose of a sample instant must not get lost; it is the last one published
        # before time stands still, so that a depth of one keeps it.
        lockstep = self._settings.lockstep
        reliability = ReliabilityPolicy.RELIABLE if lockstep else ReliabilityPolicy.BEST_EFFORT
        newest = QoSProfile(depth=1, reliability=reliability)
        take = self._take_sample if lockstep else self._take_pose
        self._inputs = [
            self.create_subscription(PoseStamped, "pose", take, newest, event_callbacks=NO_EVENTS),
            self.create_subscription(
                PoseStamped, "goal_pose", self._take_goal, 1, event_callbacks=NO_EVENTS
            ),
            self.create_service(SetBool, "~/enable", self._enable),
        ]
        if not lockstep:
            self._timer = self.create_timer(self._settings.control_period, self._tick)
        backwards = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._jumps = self.get_clock().create_jump_callback(
            backwards, post_callback=self._time_jumped
        )
        # Wall time: what is missing must be told also where simulated time stands still.
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._looks = [
            self.create_timer(_LOOK_EVERY, self._look, clock=wall),
            self.create_timer(_REMEMBER_EVERY, self._remember, clock=wall),
        ]

    def _take_clock(self) -> None:
        """Count control time on the clock that the node follows now."""
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        self._planning = PlanningTime(self._settings.control_period, self._simulated)
        self._epoch = 0 if self._simulated else self._stamp()

    def _look(self) -> None:
        now = self._now()
        self._watch.look(now, self._simulated, self._settings.pose_timeout)
        self._reports.look()
        self._goals.catch_up()
        if now is not None and not self._recalled:
            self._recall()

    def _remember(self) -> None:
        """Note the goal in force for a controller that is started after this one."""
        if self._memory is None or self._now() is None or not self._recalled:
            return
        goal = self.controller.goal if self.controller.enabled else None
        try:
            self._memory.save(goal, self._stamp(), self._simulated)
        except OSError as error:
            self._memory = None
            self._faults.report("goal not kept", f"{error}; a restart will begin without a goal")

    def _recall(self) -> None:
        """Take up the goal of a controller that ended a moment ago, unless there is a new one."""
        self._recalled = True
        if self._memory is None:
            return
        found = self._memory.recall(self._stamp(), self._simulated)
        if found is not None:
            goal, age = found
            self.get_logger().info(f"going on to the goal in force {age:.0f} s ago (goal_memory)")
            self._aim(goal)

    def _stamp(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _now(self) -> float | None:
        """Return control time [s]; None before the first message on /clock."""
        stamp = self._stamp()
        return None if self._simulated and stamp == 0 else seconds(stamp, self._epoch)

    def _tick(self) -> None:
        ahead, self._ahead = self._ahead, None
        if ahead is not None:
            self._take_pose(ahead, again=True)
        now = self._now()
        if now is not None:
            instant = self._grid.instant(now)
            self._decide(instant, now, self._planning.lead)

    def _decide(self, instant: float, now: float, lead: float = 0.0) -> None:
        began = time.perf_counter()
        # In lockstep time waits, and so that results repeat a plan may take what it takes.
        budget = math.inf
        if not self._settings.lockstep:
            budget = self._planning.budget(instant, now)
        instant += lead
        decision = self.controller.decide(instant, budget)
        # A simulated clock stands still while this callback runs; the robot does not.
        if not self._settings.lockstep:
            now = self._planning.after(now, time.perf_counter() - began)
        hold = self.controller.commit(decision, now)
        if hold is None and self._settings.lockstep:
            hold = AT_REST.delayed(instant)  # time waits for an answer, even if it is nothing
        if hold is not None:
            self._sender.send(hold, self._epoch)
        took = time.perf_counter() - began
        self._planning.took(took)
        self._reports.tick(decision, instant, took, self._epoch)
        self._starting = self._starting and not decision.solved

    def _await_start(self) -> None:
        """Expect to plan anew, which for a search takes all the time there is."""
        self._starting = True
        if self._settings.strategy == "time_optimal":
            self._planning.expect_all()

    def _start(self) -> None:
        """Begin a new grid of sample instants where somewhere to go is waiting for nothing else.

        The first plan takes longest, so it waits until its share of wall time is known.
        """
        now = self._now()
        if now is None or not self._starting or self._settings.lockstep:
            return
        if self._planning.pace is not None and self.controller.awaits_start(now):
            self._timer.reset()
            self._grid.reset()
            self._tick()

    def _take_pose(self, message: PoseStamped, again: bool = False) -> None:
        state, now = self._state(message), self._now()
        stamp = seconds(stamp_from_ros(message.header.stamp), self._epoch)
        self._watch.heard(math.nan if now is None else now - stamp)
        if state is None or now is None:
            return
        if stamp - now > self._settings.pose_timeout:
            if not again:
                # When this node was held up, the clock of that pose waits right behind it.
                self._ahead = message
                return
            # It would count as fresh for as long as it is ahead.
            if stamp - now < OTHER_CLOCK:  # else the wrong clock is told
                self._faults.report(
                    "pose refused",
                    f"given a stamp {stamp - now:.6g} s ahead of this node's clock, expected at "
                    f"most {self._settings.pose_timeout:g} s; are the clocks synchronised?",
                )
            return
        self.controller.observe(stamp, state)
        self._planning.read(now, time.monotonic())
        if not again:
            self._start()

    def _take_sample(self, message: PoseStamped) -> None:
        """Decide, in lockstep, when the pose of a sample instant arrives."""
        self._watch.heard(math.nan)
        stamp, state = stamp_from_ros(message.header.stamp), self._state(message)
        if state is None or stamp % round(self._settings.control_period * NANOSECONDS):
            return
        if stamp == self._answered:
            self._sender.repeat()
            return
        instant = seconds(stamp, self._epoch)
        self.controller.observe(instant, state)
        self._decide(instant, instant)
        self._answered = stamp

    def _take_goal(self, message: PoseStamped) -> None:
        try:
            goal = framed_pose_from_ros(message)
        except InvalidStateError as error:
            self._faults.report("goal_pose refused", f"{error}; the goal in force stays")
            return
        self._aim(goal)

    def _aim(self, goal: Vector) -> None:
        """Bring a goal, shape (6,), into force; the one that is in force is only confirmed."""
        fresh = self.controller.set_goal(goal)
        self._recalled = True
        self._reports.goal(goal, self._stamp())
        if not fresh:
            return
        self._goals.report("goal", f"{[round(float(value), 4) for value in goal]}")
        self._answered = None
        self._await_start()
        self._start()

    def _state(self, message: PoseStamped) -> Vector | None:
        try:
            return framed_pose_from_ros(message)
        except InvalidStateError as error:
            self._faults.report("pose refused", str(error))
            return None

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.controller.enabled = request.data
        now = self._now()
        if not self._settings.lockstep and now is not None and not request.data:
            self._decide(now, now)  # a stop does not wait for the next sample
        if request.data:
            self._await_start()
        response.success = True
        response.message = "enabled" if request.data else "disabled, rotors ramp to rest"
        return response

    def _change(self, settings: ControllerSettings) -> None:
        period, self._settings = self._settings.control_period, settings
        self.controller.change(settings)
        self._reports.change(settings)
        if settings.control_period != period:
            self._planning = PlanningTime(settings.control_period, self._simulated)
            self._grid.reset(settings.control_period)
            self.destroy_timer(self._timer)
            self._timer = self.create_timer(settings.control_period, self._tick)

    def _refuse(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse a strategy with another sample period in lockstep, where the simulator waits."""
        period = self._settings.control_period
        for name in (p.value for p in parameters if p.name == "strategy"):
            known = self._settings.lockstep and name in STRATEGIES
            if known and replace(self._settings, strategy=name).control_period != period:
                return SetParametersResult(
                    successful=False,
                    reason=f"strategy: given '{name}' in lockstep, expected one that samples "
                    f"every {period:g} s, as the simulator waits for",
                )
        return SetParametersResult(successful=True)

    def _time_jumped(self, jump: TimeJump) -> None:
        if jump.clock_change in _CHANGED:
            self._take_clock()
        self._faults.report("clock jumped", "poses and plans are forgotten, the goal stays")
        self.controller.forget()
        self._ahead = None
        self._grid.reset()
        self._answered = None
        self._await_start()


_ABOUT = f"""{__doc__}
Parameters are given with --ros-args -p NAME:=VALUE or --params-file FILE.yaml;
msg_docs/parameters.md lists them.
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(ControllerNode, args, _ABOUT)
