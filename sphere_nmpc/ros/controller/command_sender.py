# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of the controller's commands: first-order holds, and their samples at a rate."""

import time
from collections.abc import Callable

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.ros.cdr_messages import speeds_message, trajectory_message

_COPIES = 2
"""Number of copies that are sent, one with each sample of `command_rate`."""
_LONGEST_FINAL_RAMP = 1.0
"""Wall time that the final ramp may take [s]; launch kills a process after five."""


class CommandSender:
    """Publisher of each hold and, while one is in force, of its speeds at a fixed rate.

    After a hold has ended nothing is published, so that another node may drive the robot.

    `now` returns control time [s], None while nothing may be sent; `depth` is the number of holds
    that are kept for reliable subscribers. With one, a hold that was lost does not delay a newer
    one until it has been sent again.
    """

    def __init__(
        self, node: Node, command_rate: float, now: Callable[[], float | None], depth: int = 1
    ) -> None:
        self._period = 1.0 / command_rate
        self._now = now
        self._hold: FirstOrderHold | None = None
        # Those of the next hold go on from them: where a receiver joins both, it finds no jump.
        self._angles: Vector = np.zeros(INPUT_SIZE)
        self._silent = True
        self._trajectory: bytes | None = None
        self._copies = 0
        self._trajectories = node.create_publisher(JointTrajectory, "rotor_trajectory", depth)
        self._speeds = node.create_publisher(Float64MultiArray, "rotor_commands", 10)
        self._timer = node.create_timer(self._period, self._sample)

    def send(self, hold: FirstOrderHold, epoch: int, is_repeated: bool = False) -> None:
        """Send a hold, control times [s] since `epoch` [ns]; it replaces what was sent before.

        `is_repeated` says whether to send copies soon after it, as the first one may be lost.
        """
        if self._hold is not None:
            self._angles = self._angles + self._hold.turned(hold.start)
        self._hold = hold
        self._copies = _COPIES if is_repeated else 0
        self._silent = False
        self._trajectory = trajectory_message(hold, self._angles, epoch)
        self.repeat()

    def forget(self) -> None:
        """Send nothing more of the last hold, whose times are those of another clock."""
        self._hold = self._trajectory = None

    def repeat(self) -> None:
        """Send the last hold again, for a robot that has subscribed only now."""
        if self._trajectory is not None:
            self._trajectories.publish(self._trajectory)

    def send_final_ramp(self, moment: float) -> None:
        """Publish the speeds of the hold in force from `moment` [s] up to its end, at rest.

        It is timed by the wall clock: the timer no longer runs, and the node's clock may have
        stopped.
        """
        hold = self._hold
        if hold is None:
            return
        self._trajectories.wait_for_all_acked(Duration(seconds=0.5))
        limit = moment + _LONGEST_FINAL_RAMP
        while moment < min(hold.end, limit):
            self.repeat()  # One of them may be lost.
            self._publish(hold.at(moment))
            time.sleep(self._period)
            moment += self._period
        self._publish(hold.speeds[-1])
        self._speeds.wait_for_all_acked(Duration(seconds=0.5))

    def _sample(self) -> None:
        hold, now = self._hold, self._now()
        if hold is None or now is None:
            return
        if self._copies > 0:
            self._copies -= 1
            self.repeat()
        if self._silent:
            return
        self._silent = now > hold.end  # after its last speeds, which are zero, were published
        self._publish(hold.at(now))

    def _publish(self, speeds: Vector) -> None:
        self._speeds.publish(speeds_message(speeds))
