# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands and pushes that the simulator receives: checks, refusals, and what becomes of them."""

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidInputError, InvalidParameterError
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros.cdr import Numbers, hold_and_stamp, read
from sphere_nmpc.ros.messages import stamp_to_ros
from sphere_sim.ros.simulator.settings import PushSettings, SimulatorNodeSettings
from sphere_sim.world.simulator import Simulator

_NEGLIGIBLE_SPEED = 0.1
"""Rotor speed that moves the sphere by less than a millimetre in a second [rad/s]."""


class CommandReceiver:
    """Subscriber of both command topics; a message that is not valid has no effect.

    In lockstep stamp 0 means the first instant of the simulator rather than "now". A trajectory
    may start ahead of simulated time by the time-out of commands. `on_trajectory` is called with
    the stamp [ns] of each that was accepted; `epoch` returns the stamp [ns] of simulated time 0.
    """

    def __init__(
        self, node: Node, simulator: Simulator, settings: SimulatorNodeSettings, max_speed: float,
        fault_log: FaultLog, on_trajectory: Callable[[int], object], epoch: Callable[[], int],
    ) -> None:
        self._simulator = simulator
        self._max_speed = max_speed
        self._furthest, self._lockstep = settings.command_timeout, settings.lockstep
        self._fault_log = fault_log
        self._on_trajectory = on_trajectory
        self._epoch = epoch
        self.is_held = False
        """Whether the rotors are left at rest, whatever valid commands are received."""
        self.received = 0
        """Number of messages received, accepted or not."""
        # In lockstep time waits for each command. Otherwise one that was lost must not hold back
        # newer ones until it has been sent again, which takes up to three seconds.
        reliability = ReliabilityPolicy.RELIABLE if self._lockstep else (
            ReliabilityPolicy.BEST_EFFORT
        )
        node.create_subscription(
            JointTrajectory, "rotor_trajectory", self._receive_trajectory,
            QoSProfile(depth=10, reliability=reliability), raw=True,
        )
        node.create_subscription(
            Float64MultiArray, "rotor_commands", self._receive_speeds, 10, raw=True
        )

    def _receive_trajectory(self, message: bytes) -> None:
        self.received += 1
        simulator = self._simulator
        try:
            epoch = self._epoch()
            unstamped = 0 if self._lockstep else epoch + simulator.now
            hold, stamp = hold_and_stamp(message, unstamped, epoch)
        except InvalidInputError as error:
            self._fault_log.report("rotor_trajectory refused", str(error))
            return
        ahead = hold.start - simulator.time
        if ahead > self._furthest:
            self._fault_log.report(
                "rotor_trajectory refused",
                f"given a start {ahead:.6g} s ahead of the simulator's time, expected at most "
                f"{self._furthest:g} s; its sender needs the simulator's clock: "
                "use_sim_time:=true, or false with clock: system",
            )
            return
        late = simulator.time - hold.end
        if late > 1e-9 and not simulator.follower.is_newer(hold):
            self._fault_log.report(
                "rotor_trajectory refused",
                f"given an end {late:.6g} s ago and a start before that of the one in force, "
                "expected a newer one",
            )
            return
        # Otherwise it is a copy, in case that the first one was lost.
        if not (self.is_held or simulator.follower.has_followed(hold)):
            fastest = max(np.abs(hold.speeds).max(), np.abs(simulator.speed_reference).max())
            if late > 1e-9 and fastest > _NEGLIGIBLE_SPEED:
                # It may be a delayed ramp to rest: the command that it replaces must not continue.
                self._fault_log.report(
                    "rotor_trajectory late", f"given an end {late:.6g} s ago; the rotors ramp to "
                    "rest",
                )
            simulator.follower.follow_trajectory(hold)
            self._report_clamped()
        self._on_trajectory(stamp)

    def _receive_speeds(self, message: bytes) -> None:
        self.received += 1
        simulator = self._simulator
        try:
            speeds = read(message, Numbers).numbers
            if not self.is_held:
                simulator.follower.follow_speeds(speeds, simulator.time)
                self._report_clamped()
        except InvalidInputError as error:
            self._fault_log.report("rotor_commands refused", str(error))

    def _report_clamped(self) -> None:
        if self._fault_log.has_risen("command limited", self._simulator.follower.clamped):
            self._fault_log.report(
                "command limited",
                f"given more than the largest rotor speed, expected at most "
                f"{self._max_speed:g} rad/s",
            )


class PushReceiver:
    """Subscriber of ``~/push`` and server of the service of that name; publishes ``~/pushed``.

    `settings` returns the present ones, which have the impulse of the service; `epoch` the stamp
    [ns] of simulated time 0. Impulses are given and published in `frame`.
    """

    def __init__(
        self, node: Node, simulator: Simulator, fault_log: FaultLog, event_log: FaultLog,
        settings: Callable[[], PushSettings], epoch: Callable[[], int], frame: str,
    ) -> None:
        self._simulator = simulator
        self._fault_log, self._event_log = fault_log, event_log
        self._settings, self._epoch, self._frame = settings, epoch, frame
        self._pushed = node.create_publisher(Vector3Stamped, "~/pushed", 10)
        node.create_subscription(Vector3, "~/push", self._receive, 10)
        node.create_service(Trigger, "~/push", self._serve)

    def _receive(self, message: Vector3) -> None:
        try:
            settings = PushSettings(push_impulse=(message.x, message.y))
            if message.z != 0.0:
                raise InvalidParameterError("z", message.z, "z = 0: a horizontal push")
        except InvalidParameterError as error:
            given = [message.x, message.y, message.z]
            self._fault_log.report("push refused", f"given {given}, expected {error.expected}")
            return
        self._push(settings)

    def _serve(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        response.message = f"pushed with {self._push(self._settings())}"
        return response

    def _push(self, settings: PushSettings) -> str:
        """Push the sphere, and return impulse and time as text."""
        x, y = settings.push_impulse
        self._simulator.plant.push((x, y))
        message = Vector3Stamped(vector=Vector3(x=x, y=y))
        message.header.frame_id = self._frame
        message.header.stamp = stamp_to_ros(self._epoch() + self._simulator.now)
        self._pushed.publish(message)
        done = f"{[x, y]} N s at t = {self._simulator.time:.3f} s"
        self._event_log.report("push", done)
        return done
