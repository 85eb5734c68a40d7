# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands within the limits of the drives: each joins the one in force and ends at rest."""

import numpy as np

from sphere_nmpc.control.clock_watch import MOST_AHEAD
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE

REACH = 3.0
"""Time after which a command that is not renewed ramps the rotors to rest [s]."""


class Commands:
    """Holds that were sent, and those that can follow.

    Times are control times [s].

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self._max_speed = robot.max_rotor_speed
        self._max_acceleration = robot.max_rotor_acceleration
        self.sent = SentInputs()
        """History of the holds sent."""

    def in_force(self, time: float) -> FirstOrderHold:
        """Return the hold in force from `time` on; before the first one rest."""
        newest = self.sent.newest
        hold = FirstOrderHold.constant(time, np.zeros(INPUT_SIZE)) if newest is None else newest
        return hold.starting_at(time, self.sent.at(time))

    def ramp_to_rest(self, time: float) -> FirstOrderHold:
        """Return the ramp from the speeds in force at `time` to zero."""
        return FirstOrderHold.ramp_to_rest(time, self.sent.at(time), self._max_acceleration)

    def earliest(self, now: float) -> float:
        """Return the time at which a command can start: the clock may be slightly late."""
        newest = self.sent.newest
        is_near = newest is not None and now <= newest.start <= now + MOST_AHEAD
        return newest.start if newest is not None and is_near else now

    def joined(self, hold: FirstOrderHold, start: float, period: float) -> FirstOrderHold:
        """Return the hold from the speeds in force at `start` on, within all limits, to rest.

        It ends `REACH` or two control periods `period` [s] later: a robot that gets no further
        command must not roll on.
        """
        reach = max(REACH, 2.0 * period)
        led = self.sent.leading_to(hold, start).until(start + reach).in_nanoseconds()
        limited = led.limited(self._max_speed, self._max_acceleration)
        return limited.ending_at_rest(self._max_acceleration)
