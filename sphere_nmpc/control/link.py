# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands on their way to the rotors, and poses on their way back.

Each command joins the one in force, within the limits of the drives, and ends at rest.
"""

import math
from collections import deque

import numpy as np

from sphere_nmpc.control.timing import MOST_AHEAD
from sphere_nmpc.estimation.rotor_history import LONGEST_WINDOW, RotorHistory
from sphere_nmpc.model.first_order_hold import SHORTEST, FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.reporting.recent import Recent

REACH = 3.0
"""Time after which a command that is not renewed stops [s]."""
_MAX_POSES = 256
"""Poses that delay and loss are taken of."""
_MIN_LINK_DELAY = 5e-3
"""Delay of poses [s] below which there is no link, only the time that a message takes."""
_MAX_LOSS = 0.01
"""Share of lost commands up to which the link counts as without losses."""


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
        self.rotors = RotorHistory(robot.max_rotor_acceleration)
        """History of the holds sent."""
        self._begun: FirstOrderHold | None = None
        self._stops = False
        self._newest: FirstOrderHold | None = None
        self._renewed_at = -math.inf

    def in_force(self, time: float) -> FirstOrderHold:
        """Return the hold in force from `time` on; before the first one rest."""
        newest = self.rotors.newest
        hold = FirstOrderHold.constant(time, np.zeros(INPUT_SIZE)) if newest is None else newest
        return hold.starting_at(time, self.rotors.at(time))

    def stop(self, time: float) -> FirstOrderHold:
        """Return the hold from `time` on that comes to rest on the path of the one in force."""
        in_force = self.in_force(time)
        if self._stops and self._newest is not None and self._newest is self.rotors.newest:
            return in_force
        return in_force.stop(time, self._max_acceleration)

    def rest_of(self, hold: FirstOrderHold, time: float) -> FirstOrderHold | None:
        """Return the rest of the newest command from `time` on if it follows a hold, else None.

        It is None as well where the stop at its end has come near, or its end within the shortest
        interval.
        """
        newest = self.rotors.newest
        if hold is not self._begun or newest is None or newest is not self._newest:
            return None
        if time > self._renewed_at or 0.0 < newest.end - time <= SHORTEST:
            return None
        time = round(time * NANOSECONDS) / NANOSECONDS  # on the line between two knots
        return newest.starting_at(time, newest.at(time), SHORTEST)

    def begin(self, hold: FirstOrderHold, sent: FirstOrderHold, stops: bool) -> None:
        """Begin to follow a hold by what is sent; `stops` says whether it is a stop."""
        self._begun, self._stops = hold, stops
        self._renewed_at = sent.start + 0.5 * REACH

    def record(self, sent: FirstOrderHold) -> None:
        """Record a command as sent."""
        self.rotors.record(sent)
        self._newest = sent

    def earliest(self, now: float) -> float:
        """Return the time at which a command can start: the clock may be slightly late."""
        newest = self.rotors.newest
        is_near = newest is not None and now <= newest.start <= now + MOST_AHEAD
        return newest.start if newest is not None and is_near else now

    def joined(
        self, hold: FirstOrderHold, start: float, period: float, reach: float = REACH
    ) -> FirstOrderHold:
        """Return the hold from the speeds in force at `start` on, within all limits, to rest.

        It stops on its path `reach` [s] or two control periods `period` [s] later: a robot that
        gets no further command must not roll on.
        """
        last = start + max(reach, 2.0 * period)
        led = self.rotors.leading_to(hold, start)
        if led.end > last:
            led = led.stop(last, self._max_acceleration)
        limited = led.in_nanoseconds().limited(self._max_speed, self._max_acceleration)
        return limited.stop(limited.end, self._max_acceleration)


class Link:
    """Delay and loss of commands and poses, as far as measured rotor speeds and stamps show them.

    From the delays follows the commitment window: how far ahead a new plan may first differ from
    the one in force. Commands are expected to be at least as late as poses, and without measured
    speeds to be lost as often. Measured speeds that the motion contradicts are not used.

    Times are control times [s].

    Parameters
    ----------
    rotors : RotorHistory
        History of the commands, with the measured speeds.
    """

    def __init__(self, rotors: RotorHistory) -> None:
        self._rotors = rotors
        self._times: deque[float] = deque(maxlen=_MAX_POSES)
        self._ages = Recent(_MAX_POSES)

    def pose_received(self, time: float, age: float) -> None:
        """Record a pose measured at `time` [s], which is `age` old; nan if that is unknown."""
        if self._times and time <= self._times[-1]:
            if time > self._times[0]:
                return  # Overtaken by a newer one.
            self._times.clear()
            self._ages.clear()
        self._times.append(time)
        if not math.isnan(age):
            self._ages.append(age)

    @property
    def pose_delay(self) -> float:
        """Mean age of the poses when they were received [s]; nan if unknown.

        Where the clock is a topic, it is delayed as well, so that the age shows the difference.
        """
        return self._ages.mean

    @property
    def pose_loss(self) -> float:
        """Share of poses that were not received, from the gaps between stamps; nan if unknown."""
        if len(self._times) < 3:
            return math.nan
        gaps = np.diff(self._times)
        missing = float(np.sum(np.maximum(0.0, np.round(gaps / np.median(gaps)) - 1.0)))
        return missing / (missing + gaps.size)

    @property
    def window(self) -> float:
        """Delay that commands may have without being late [s]; 0 without a link."""
        late = 0.0 if self._rotors.contradicted else max(self._rotors.delays, default=0.0)
        delay = self.pose_delay
        return min(max(late, delay if delay > _MIN_LINK_DELAY else 0.0), LONGEST_WINDOW)

    @property
    def loss(self) -> float:
        """Share of the newest commands that did not take effect before the next one."""
        is_measured = self._rotors.is_measured and not self._rotors.contradicted
        loss = self._rotors.losses.mean if is_measured else self.pose_loss
        return 0.0 if math.isnan(loss) else loss

    @property
    def is_apparent(self) -> bool:
        """Whether commands have been late or lost lately."""
        return self.window > 0.0 or self.loss > _MAX_LOSS

    @property
    def needs_speeds(self) -> bool:
        """Whether measured speeds are of use: not where all commands take effect in time."""
        return not self._rotors.is_known or self.is_apparent or self._rotors.contradicted
