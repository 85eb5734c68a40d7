# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of the simulator's commands: checks, refusals, and what the drives follow."""

from collections.abc import Callable

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros.messages import hold_and_stamp, speeds_of_message
from sphere_sim.world.simulator import Simulator

_NEGLIGIBLE_SPEED = 0.1
"""Rotor speed that moves the sphere by less than a millimetre in a second [rad/s]."""


class CommandReceiver:
    """Subscriber of both command topics; a message that is not valid has no effect.

    Parameters
    ----------
    node : Node
        Node of the subscriptions.
    simulator : Simulator
        Simulator that follows the commands.
    max_speed : float
        Largest rotor speed of the drives [rad/s].
    horizon : float
        How far ahead of simulated time a trajectory may start [s].
    fault_log : FaultLog
        Log of refused commands.
    zero_is_time : bool
        Whether stamp 0 means the first instant, as in lockstep, rather than "now".
    on_trajectory : callable
        Called with the stamp [ns] of each trajectory that was accepted.
    epoch : callable
        Returns the stamp [ns] of simulated time 0.
    """

    def __init__(
        self,
        node: Node,
        simulator: Simulator,
        max_speed: float,
        horizon: float,
        fault_log: FaultLog,
        zero_is_time: bool,
        on_trajectory: Callable[[int], object],
        epoch: Callable[[], int],
    ) -> None:
        self._simulator = simulator
        self._max_speed = max_speed
        self._horizon = horizon
        self._fault_log = fault_log
        self._zero_is_time = zero_is_time
        self._on_trajectory = on_trajectory
        self._epoch = epoch
        self.received = 0
        """Number of messages received, accepted or not."""
        # In lockstep time waits for each command. Otherwise one that was lost must not hold back
        # newer ones until it has been sent again, which takes up to three seconds.
        newest = QoSProfile(
            depth=10,
            reliability=ReliabilityPolicy.RELIABLE if zero_is_time
            else ReliabilityPolicy.BEST_EFFORT,
        )
        self._trajectories = node.create_subscription(
            JointTrajectory, "rotor_trajectory", self._receive_trajectory, newest, raw=True
        )
        self._speeds = node.create_subscription(
            Float64MultiArray, "rotor_commands", self._receive_speeds, 10, raw=True
        )

    def _receive_trajectory(self, message: bytes) -> None:
        self.received += 1
        simulator = self._simulator
        try:
            epoch = self._epoch()
            unstamped = 0 if self._zero_is_time else epoch + simulator.now
            hold, stamp = hold_and_stamp(message, unstamped, epoch)
        except InvalidInputError as error:
            self._fault_log.report("rotor_trajectory refused", str(error))
            return
        ahead = hold.start - simulator.time
        if ahead > self._horizon:
            self._fault_log.report(
                "rotor_trajectory refused",
                f"given a start {ahead:.6g} s ahead of the simulator's time, expected at most "
                f"{self._horizon:g} s; its sender needs the simulator's clock: "
                "use_sim_time:=true, or false with clock: system",
            )
            return
        if hold.end < simulator.time - 1e-9 and not simulator.follower.is_newer(hold):
            self._fault_log.report(
                "rotor_trajectory refused",
                f"given an end {simulator.time - hold.end:.6g} s ago and a start before that of "
                "the one in force, expected a newer one",
            )
            return
        if simulator.follower.has_followed(hold):
            self._on_trajectory(stamp)  # a copy, in case that the first one was lost
            return
        fastest = max(np.abs(hold.speeds).max(), np.abs(simulator.speed_reference).max())
        if hold.end < simulator.time - 1e-9 and fastest > _NEGLIGIBLE_SPEED:
            # It may be a delayed ramp to rest: the command that it replaces must not continue.
            self._fault_log.report(
                "rotor_trajectory late",
                f"given an end {simulator.time - hold.end:.6g} s ago; the rotors ramp to rest",
            )
        simulator.follower.follow_trajectory(hold)
        self._report_clamped()
        self._on_trajectory(stamp)

    def _receive_speeds(self, message: bytes) -> None:
        self.received += 1
        simulator = self._simulator
        try:
            speeds = speeds_of_message(message)
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
