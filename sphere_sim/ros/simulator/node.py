# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node: a sphere with two rotors, its drives, its sensors and its clock.

publishes   pose and odom, with pose_source odometry as ground_truth/pose and ground_truth/odom,
            imu, joint_states, robot_description, /clock unless it runs on the system clock,
            /diagnostics, ~/pushed
subscribes  rotor_trajectory, rotor_commands, control_period, map, ~/push, in lockstep the
            controller's status, with an odometry node the first pose
services    ~/reset, ~/pause, ~/step, ~/push; with an odometry node calls its ~/reset
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace

from geometry_msgs.msg import PoseStamped
from rclpy.executors import Executor
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.settings import OccupancySettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, as_state
from sphere_nmpc.quantities import NANOSECONDS, counted
from sphere_nmpc.reporting.conditions import OK, WARN, Condition, Kind, Report
from sphere_nmpc.ros.cdr import Pose, fields
from sphere_nmpc.ros.diagnostics import Diagnostics
from sphere_nmpc.ros.floor_receiver import FloorReceiver
from sphere_nmpc.ros.graph_monitor import GraphMonitor, publishers_of
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode
from sphere_nmpc.ros.lifetime import run
from sphere_nmpc.ros.pose_publisher import frame_prefix
from sphere_nmpc.ros.settings import FrameSettings, SchedulingSettings
from sphere_sim.ros.simulator.controllers import Controllers
from sphere_sim.ros.simulator.receivers import CommandReceiver, PushReceiver
from sphere_sim.ros.simulator.settings import PushSettings, SimulatorNodeSettings
from sphere_sim.ros.simulator.state_publisher import StatePublisher
from sphere_sim.world.clock import SimulatedClock
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.drives import beyond
from sphere_sim.world.imu_sensor import SimulatedImuSettings
from sphere_sim.world.plant.factory import make_plant, settings_class
from sphere_sim.world.robot_description import make_urdf
from sphere_sim.world.settings import PLANTS
from sphere_sim.world.simulator import Simulator
from sphere_sim.world.walls import walls_of

_REPEAT_EVERY = 0.2
"""Wall time between two repetitions of an instant at which time stands still [s]."""
_SPIN_EVERY = 2e-3
"""Wall time between two calls of the executor [s]; each takes some 0.2 ms."""
_SHORTEST_SPIN = 2e-4
"""Time to the next instant above which the executor waits for it, rather than a sleep [s]."""
_FLUSH_TIMEOUT = 1.0
"""Longest wait of a pause until subscribers have received all messages [s, wall]."""
_LARGEST_PRIORITY_FACTOR = 2.0
"""Real-time factor up to which the node may have a real-time priority."""
_CLOCK_JUMP = 1_000_000_000
"""Jump of the system clock that the stamps follow [ns]; a smaller one counts as drift."""


class SimulatorNode(GuardedNode):
    """Node that advances a `Simulator` with the wall clock or in lockstep with the controller.

    Parameters
    ----------
    parameter_overrides : list of Parameter, optional
        Parameters as given on a command line; for use within a program.
    """

    uses_events_executor = True

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("simulator", parameter_overrides)
        declare = self.parameters.declare
        declared = declare(SimulatorNodeSettings(), on_change=self._change)
        settings = self._settings = declared.settings
        imu = declare(SimulatedImuSettings(), "imu").settings
        if settings.lockstep and settings.has_odometry and imu.latency:
            raise InvalidParameterError(
                "imu.latency", imu.latency, "0 with lockstep: true and pose_source: odometry, "
                "where the command for a sampling instant would never arrive",
            )
        robot = self._robot = declare(RobotParameters(), "robot").settings
        # Those of all plants of this package, as a file may have them for another choice.
        own = {
            name: declare(settings_class(name)(), name).settings
            for name in sorted({*PLANTS.own, settings.plant})
        }
        self._own = own[settings.plant].for_robot(robot)
        disturbances = declare(DisturbanceSettings(), on_change=lambda new: (
            self.simulator.plant.tilt(new.slope, new.slope_direction)
        )).settings
        pushes = declare(PushSettings())
        self._scheduling = declare(SchedulingSettings())
        frame = declare(FrameSettings()).settings.world_frame
        occupancy = declare(
            OccupancySettings(), prepare=lambda *change: self._floor_receiver.prepare(*change)
        ).settings
        self.parameters.warn_of_unknown()
        self._floor_receiver = FloorReceiver(
            self, occupancy, robot.shell_radius, frame, walls_of,
            lambda walls: self.simulator.plant.surround(walls), self._fault_log, self._event_log,
            is_planner=False,
        )
        self.resources.callback(self._floor_receiver.close)
        start, walls = as_state(settings.initial_state), self._floor_receiver.floor
        plant = make_plant(settings.plant, robot, start, self._own, disturbances, walls)
        self.simulator = Simulator(settings, robot, plant, imu if settings.has_odometry else None)
        self._simulated_clock = SimulatedClock(
            round(NANOSECONDS / settings.pose_rate), round(NANOSECONDS * settings.sample_period),
            settings.real_time_factor, settings.lockstep and not settings.has_odometry,
            settings.lockstep_timeout, settings.start_paused, keeps_up=settings.is_on_system_clock,
        )
        self._first_pose: Subscription | None = None
        self._begun_at = -math.inf
        """Stamp at which the odometry has begun [ns], up to which its poses may be of before."""
        if settings.has_odometry:
            self._await_odometry()
        self._monitor = GraphMonitor(self, self._fault_log)
        commands = self.resolve_topic_name("rotor_trajectory")
        self._controllers = Controllers(
            self, lambda: self._monitor.known_publishers(commands, JointTrajectory),
            settings.lockstep,
        )
        self._controller_found = self._period_told = False
        self._state_publisher = StatePublisher(
            self, robot.shell_radius, frame_prefix(self, settings.frame_prefix), frame,
            clocked=not settings.is_on_system_clock, has_odometry=settings.has_odometry, imu=imu,
        )
        self._receiver = CommandReceiver(
            self, self.simulator, settings, robot.max_rotor_speed, self._fault_log,
            self._command_received, lambda: self._state_publisher.epoch,
        )
        description = String(data=make_urdf(robot, imu=imu))
        self.create_publisher(String, "robot_description", LATCHED).publish(description)
        self.create_subscription(Float64, "control_period", self._receive_period, LATCHED)
        self.create_service(Trigger, "~/reset", self._reset)
        has_odometry = settings.has_odometry
        self._odometry = self.create_client(Trigger, "odometry/reset") if has_odometry else None
        self.create_service(SetBool, "~/pause", self._pause)
        self.create_service(Trigger, "~/step", self._step)
        PushReceiver(
            self, self.simulator, self._fault_log, self._event_log, lambda: pushes.settings,
            lambda: self._state_publisher.epoch, frame,
        )
        Diagnostics(
            self, lambda: self._state_publisher.epoch + self.simulator.now,
            {"clock": self._report_clock, "commands": self._report_commands},
        )
        wall = self._spun_at = self._published_at = time.monotonic()
        self._simulated_clock.achieved(0, wall)
        # By how much the system clock was ahead of the steady one when the stamps followed it.
        self._set_at = time.time_ns() - time.monotonic_ns()
        if settings.is_on_system_clock:
            self._state_publisher.epoch = time.time_ns()
        self._state_publisher.publish(self.simulator)
        if not self._simulated_clock.paused:
            self._simulated_clock.resume(0, wall)

    @property
    def thread_priority(self) -> int:
        """Real-time priority as set, up to twice real time; beyond, it would fill a processor."""
        if self._settings.lockstep:
            return 0
        is_slow = 0.0 < self._settings.real_time_factor <= _LARGEST_PRIORITY_FACTOR
        return self._scheduling.settings.thread_priority if is_slow else 0

    def work(self, executor: Executor) -> None:
        """Advance to the next instant if it is due, and call the executor at intervals."""
        wall = time.monotonic()
        wait = self._simulated_clock.wait(self.simulator.now, wall, self._controller_found)
        if self._fault_log.has_risen("lockstep time-out", self._simulated_clock.timeouts):
            self._report_timeout()
        if wait <= 0.0:
            self._advance()
            wait = self._simulated_clock.wait(
                self.simulator.now, time.monotonic(), self._controller_found
            )
        self._spin(executor, min(wait, _REPEAT_EVERY))
        if wait >= _REPEAT_EVERY and time.monotonic() > self._published_at + _REPEAT_EVERY:
            senders = publishers_of(self, "rotor_trajectory", JointTrajectory)
            self._controller_found |= bool(senders)
            if self._simulated_clock.awaited is not None and not self._controller_found:
                self._fault_log.report(
                    "lockstep", "given no publisher of rotor_trajectory, expected one; time waits"
                )
            self._state_publisher.repeat()
            self._published_at = time.monotonic()

    def _follow_system_clock(self) -> None:
        """Shift the stamps when the system clock is set."""
        jump = time.time_ns() - time.monotonic_ns() - self._set_at
        if self._settings.is_on_system_clock and abs(jump) > _CLOCK_JUMP:
            self._state_publisher.epoch += jump
            self._set_at += jump
            self._fault_log.report(
                "system clock jumped", f"given a jump of {jump * 1e-9:.3f} s, expected a clock "
                "that is adjusted gradually; stamps jump with it",
            )

    def _advance(self) -> None:
        instant = self._simulated_clock.due(self.simulator.now, time.monotonic())
        self.simulator.advance_to(instant)
        self._report_touch()
        self._follow_system_clock()
        self._simulated_clock.advanced(instant, time.monotonic())
        self._state_publisher.publish(self.simulator)
        self._published_at = time.monotonic()

    def _spin(self, executor: Executor, wait: float) -> None:
        if wait > _SHORTEST_SPIN:
            executor.spin_once(timeout_sec=wait)
            received = -1  # further messages may be waiting
        elif time.monotonic() > self._spun_at + _SPIN_EVERY:
            received = -1
        else:
            time.sleep(max(0.0, wait))
            return
        # At a high control rate several commands arrive between two instants: the newest counts.
        while self._receiver.received != received:
            received = self._receiver.received
            executor.spin_once(timeout_sec=0.0)
        self._spun_at = time.monotonic()

    def _command_received(self, stamp: int) -> None:
        awaited = self._simulated_clock.awaited is not None
        if awaited and not self._period_told and publishers_of(self, "control_period", Float64):
            return  # the next instant is not known yet; the command is sent again with the pose
        self._simulated_clock.command_received(stamp, time.monotonic())

    def _receive_period(self, message: Float64) -> None:
        """Take over, in lockstep, the controller's period: time stops at its instants."""
        try:
            period = replace(self._settings, sample_period=message.data).sample_period
        except InvalidParameterError as error:
            line = f"given {message.data!r}, expected {error.expected}"
            self._fault_log.report("control_period refused", line)
            return
        if not self._settings.lockstep:
            return
        self._period_told = True
        self._simulated_clock.set_sample_period(round(NANOSECONDS * period), time.monotonic())
        self.get_logger().info(f"lockstep: every {period:g} s, as the controller samples")

    def _await_odometry(self) -> None:
        """Let time run freely until the odometry has a pose, after a calibration.

        Before, the controller has no answer.
        """
        self._simulated_clock.run_freely(time.monotonic())
        self._has_pose = False
        if self._first_pose is None:
            self._first_pose = self.create_subscription(
                PoseStamped, "pose", self._receive_pose, 1, raw=True
            )

    def _odometry_begun(self, _: object) -> None:
        self._begun_at = self._state_publisher.epoch + self.simulator.now

    def _receive_pose(self, message: bytes) -> None:
        if fields(message, Pose)[0] > self._begun_at:
            self._receiver.is_held = False
            self._simulated_clock.lockstep = self._settings.lockstep
            self._has_pose = True

    def _report_timeout(self) -> None:
        timeout = self._settings.lockstep_timeout
        self._fault_log.report(
            "lockstep time-out",
            f"given no rotor_trajectory for t = {self.simulator.time:.3f} s, expected one within "
            f"{timeout:g} s; time continues without it; {self._controllers.why_silent(timeout)}",
        )

    def _report_touch(self) -> None:
        touches = self.simulator.touches
        if self._fault_log.has_risen("wall touched", touches):
            x, y = self.simulator.plant.state[POSITION]
            self._fault_log.report(
                "wall touched", f"by the sphere at [{x:.3f}, {y:.3f}] m, t = "
                f"{self.simulator.time:.3f} s; {counted(touches, 'contact')} so far",
            )

    def _change(self, settings: SimulatorNodeSettings) -> None:
        if settings.real_time_factor != self._settings.real_time_factor:
            now = self.simulator.now
            self._simulated_clock.set_pace(settings.real_time_factor, now, time.monotonic())
        self._settings = settings
        self.simulator.change(settings)

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.simulator.reset()
        self._state_publisher.publish(self.simulator)
        response.success = True
        response.message = f"at the start again, at t = {self.simulator.time:.3f} s"
        if self._odometry is not None and self._odometry.service_is_ready():
            # What the controller plans until it misses the poses is of before, too.
            self._receiver.is_held = True
            self._begun_at = math.inf
            self._await_odometry()
            answer = self._odometry.call_async(Trigger.Request())
            answer.add_done_callback(self.guarded("reset", self._odometry_begun))
            response.message += "; the odometry begins anew"
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._settings.is_on_system_clock:
            response.message = "given clock: system, which cannot be paused, expected simulated"
            return response
        if request.data:
            self._simulated_clock.pause()
            self._state_publisher.flush(_FLUSH_TIMEOUT)
        elif self._simulated_clock.stops:
            self._simulated_clock.resume(self.simulator.now, time.monotonic())
            self._state_publisher.repeat()
        response.success = True
        state = "paused" if request.data else "running"
        response.message = f"{state} at t = {self.simulator.time:.3f} s"
        return response

    def _step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._simulated_clock.paused
        if not self._simulated_clock.paused:
            response.message = "given a running simulator, expected a paused one"
            return response
        until = self._simulated_clock.step(self.simulator.now, time.monotonic())
        self._state_publisher.repeat()
        response.message = f"running as far as t = {until / NANOSECONDS:.3f} s"
        return response

    def _report_clock(self) -> Report:
        others = self._monitor.further_publishers(clocked=not self._settings.is_on_system_clock)
        self._controllers.update()
        if self._first_pose is not None and self._has_pose:
            self.destroy_subscription(self._first_pose)
            self._first_pose = None
        self._monitor.update([
            *self._monitor.incompatible(), *others, *self._contradictions(),
            *self._floor_receiver.faults(),
        ])
        clock, wanted = self._simulated_clock, self._settings.real_time_factor
        achieved = clock.achieved(self.simulator.now, time.monotonic())
        values = {
            "time": self.simulator.time,
            "real time factor": achieved,
            "real time factor wanted": wanted,
            "wall time lost": clock.lost,
            "paused": clock.paused,
            "lockstep": clock.lockstep,
            "lockstep time-outs": clock.timeouts,
        }
        if self._monitor.faults:
            return WARN, self._monitor.faults[0].name, values
        if clock.paused:
            return OK, "paused", values
        if clock.awaited is not None and achieved == 0.0:
            return WARN, "waiting for rotor_trajectory", values
        if clock.is_slow(achieved):
            return WARN, f"slower than set: real-time factor {achieved:.3g} of {wanted:g}", values
        return OK, "running", values

    def _contradictions(self) -> list[Condition]:
        """Return the faults of limits that contradict each other, here and in the controller."""
        faults, torque = [], math.inf
        own = self._own.contradiction(self._robot)
        if own is not None:
            faults.append(Condition(Kind.LIMITS, own))
        else:
            torque = self._own.torque_limit
        for controller, planned in self._controllers.limits.items():
            line = beyond(self._robot, planned, controller, torque, self._settings.plant)
            if line:
                faults.append(Condition(Kind.LIMITS_OF, line, controller))
        return faults

    def _report_commands(self) -> Report:
        self._event_log.flush()
        counts = dict(self._fault_log.counts)
        return (WARN, "faults so far", counts) if counts else (OK, "no faults", counts)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(SimulatorNode, args, __doc__ or "")
