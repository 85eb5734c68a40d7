# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands on their way to the rotors, and poses on their way back.

Each command joins the one in force, within the limits of the drives, and ends at rest. Measured
rotor speeds show which of them are followed, and since when.
"""

import math
from collections import deque

import numpy as np

from sphere_nmpc.control.recent import RECENT, Recent
from sphere_nmpc.control.timing import MOST_AHEAD
from sphere_nmpc.estimation.posterior import SHARE_STEP
from sphere_nmpc.estimation.sent_inputs import LONGEST_WINDOW, SentInputs
from sphere_nmpc.model.first_order_hold import SHORTEST, FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.reporting.conditions import Condition, Kind

REACH = 3.0
"""Time after which a command that is not renewed stops [s]."""
_MIN_DIFFERENCE = 0.5
"""Difference of two commands above which measured speeds show which one is followed [rad/s]."""
_MAX_DISTANCE_RATIO = 0.5
"""Distance to the command that is followed over that to the other one, below which it is clear."""
_MAX_COMMANDS = 256
"""Newest commands that may still take effect, half a second of them at the highest rate, and poses
that delay and loss are taken of."""
NEGLIGIBLE = 0.025
"""Delay of a command up to which it counts as in time [s; of its motion for the robot of Table 1].
That of one late by 0.1 s is up to 10 mm from the planned one, which grows with the square of the
delay, and a plan that is followed has a margin of 2.1 mm."""
_MAX_DELAY_SPACINGS = 1.25
"""Delay up to which a command also counts as in time [spacings of the measurements]: a clock that
is a topic has the same spacing, and commands are late by that alone."""
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
        self.sent = SentInputs()
        """History of the holds sent."""
        self._begun: FirstOrderHold | None = None
        self._stops = False
        self._newest: FirstOrderHold | None = None
        self._renewed_at = -math.inf

    def in_force(self, time: float) -> FirstOrderHold:
        """Return the hold in force from `time` on; before the first one rest."""
        newest = self.sent.newest
        hold = FirstOrderHold.constant(time, np.zeros(INPUT_SIZE)) if newest is None else newest
        return hold.starting_at(time, self.sent.at(time))

    def stop(self, time: float) -> FirstOrderHold:
        """Return the hold from `time` on that comes to rest on the path of the one in force."""
        in_force = self.in_force(time)
        if self._stops and self._newest is not None and self._newest is self.sent.newest:
            return in_force
        return in_force.stop(time, self._max_acceleration)

    def rest_of(self, hold: FirstOrderHold, time: float) -> FirstOrderHold | None:
        """Return the rest of the newest command from `time` on if it follows a hold, else None.

        It is None as well where the stop at its end has come near, or its end within the shortest
        interval.
        """
        newest = self.sent.newest
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
        self.sent.record(sent)
        self._newest = sent

    def earliest(self, now: float) -> float:
        """Return the time at which a command can start: the clock may be slightly late."""
        newest = self.sent.newest
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
        led = self.sent.leading_to(hold, start)
        if led.end > last:
            led = led.stop(last, self._max_acceleration)
        limited = led.in_nanoseconds().limited(self._max_speed, self._max_acceleration)
        return limited.stop(limited.end, self._max_acceleration)


class PoseLink:
    """Delay and loss of the newest poses, as far as their stamps show them.

    Times are control times [s].
    """

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=_MAX_COMMANDS)
        self._ages = Recent(_MAX_COMMANDS)

    def received(self, time: float, age: float) -> None:
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
    def delay(self) -> float:
        """Mean age of the poses when they were received [s]; nan if unknown.

        Where the clock is a topic, it is delayed as well, so that the age shows the difference.
        """
        return self._ages.mean

    @property
    def loss(self) -> float:
        """Share of poses that were not received, from the gaps between stamps; nan if unknown."""
        if len(self._times) < 3:
            return math.nan
        gaps = np.diff(self._times)
        missing = float(np.sum(np.maximum(0.0, np.round(gaps / np.median(gaps)) - 1.0)))
        return missing / (missing + gaps.size)


class RotorFeedback:
    """Comparison of measured rotor speeds with the commands that were sent.

    A command that measured speeds do not show to be followed is withdrawn from the history of the
    speeds sent; where it takes effect later it is entered again from then on. So a command that is
    late or lost on its way is taken neither for another plant nor for momentum. From the delays
    follows the commitment window: how far ahead a new plan may first differ from the one in force.
    Commands are expected to be at least as late as poses, and without measured speeds to be lost
    as often. Measured speeds that the motion contradicts are not used.

    Times are control times [s].

    Parameters
    ----------
    sent : SentInputs
        History of the commands, which is corrected.
    acceleration : float
        Limit of the rotors' acceleration, by which they catch up with a late command [rad/s^2].
    """

    def __init__(self, sent: SentInputs, acceleration: float) -> None:
        self._sent = sent
        self._acceleration = acceleration
        self.poses = PoseLink()
        """What the poses show of the link."""
        self._is_measured = False
        self._delays, self._losses = Recent(), Recent()
        self.delay = float("nan")
        """Delay of the newest late command from sending to its effect [s]; nan without any."""
        self.reset()

    def reset(self) -> None:
        """Forget all commands, as after a jump of the clock; what is known of delays is kept."""
        self._followed: FirstOrderHold | None = None
        self._waiting: deque[tuple[FirstOrderHold, bool]] = deque(maxlen=_MAX_COMMANDS)
        self._measured: tuple[float, Vector] = (float("-inf"), np.zeros(INPUT_SIZE))
        self._between: list[tuple[float, Vector]] = []
        self._gaps = Recent()
        self.resume()

    def resume(self) -> None:
        """Ask for measured speeds again, as the link may be another one."""
        self._known = 0

    @property
    def window(self) -> float:
        """Delay that commands may have without being late [s]; 0 without a link."""
        late = 0.0 if self._sent.contradicted else max(self._delays, default=0.0)
        delay = self.poses.delay
        return min(max(late, delay if delay > _MIN_LINK_DELAY else 0.0), LONGEST_WINDOW)

    @property
    def loss(self) -> float:
        """Share of the newest commands that did not take effect before the next one."""
        is_measured = self._is_measured and not self._sent.contradicted
        loss = self._losses.mean if is_measured else self.poses.loss
        return 0.0 if math.isnan(loss) else loss

    @property
    def is_needed(self) -> bool:
        """Whether measured speeds are of use: not where all commands take effect in time."""
        return self._known < RECENT or self.shows_link or self._sent.contradicted

    @property
    def condition(self) -> Condition | None:
        """The warning about measured speeds that are not used; None without one."""
        if not self._sent.contradicted:
            return None
        return Condition(
            Kind.SPEEDS_CONTRADICTED, "given speeds in joint_states by which the sphere would not "
            "have moved as its poses show, while the commands explain it, expected those of the "
            "rotors [rad/s] when they were measured; they are left out: are they always 0, in "
            "another unit, or stamped late?",
        )

    @property
    def shows_link(self) -> bool:
        """Whether commands have been late or lost lately."""
        return self.window > 0.0 or self.loss > _MAX_LOSS

    def sent(self, hold: FirstOrderHold) -> None:
        """Take a hold that is sent now, its first knot."""
        self._waiting.append((hold, False))

    def observe(self, time: float, speeds: Vector, lag: float = 0.0) -> None:
        """Take rotor speeds [rad/s], shape (2,), measured at `time` [s].

        `lag` is the delay of the rotors behind the speeds that their drives follow [s].
        """
        time -= lag
        since, before = self._measured
        if time <= since:
            return
        self._measured, self._is_measured = (time, speeds), True
        if np.isfinite(since):
            self._gaps.append(time - since)
        self._sent.known_until = time
        due = [i for i, (hold, _) in enumerate(self._waiting) if hold.start <= time]
        if not due:
            return
        old = self._speeds_before(time)
        if _distance(self._waiting[due[-1]][0].at(time), old) <= _MIN_DIFFERENCE:
            return
        new = [self._waiting[i][0].at(time) for i in due]
        errors = [_distance(speeds, each) for each in new]
        # Of commands that agree, the newest.
        best = min(reversed(due), key=lambda i: errors[i])
        if _distance(speeds, old) < _MAX_DISTANCE_RATIO * errors[best]:
            self._overdue(due, time)
            return
        is_late = self._waiting[best][1] or bool(self._between)
        if errors[best] <= _MIN_DIFFERENCE < float(np.max(np.abs(speeds))):
            self._sent.confirm()
        if errors[best] > _MIN_DIFFERENCE:
            self._between.append((time, speeds))
            if not is_late:
                return  # The next measurement shows whether the rotors are late or weak.
            steepest = _distance(speeds, before) / (time - since)
            is_late = self._waiting[best][1] or steepest > (1.0 - SHARE_STEP) * self._acceleration
        self._took_effect(best, is_late, time, speeds)

    def _speeds_before(self, time: float) -> Vector:
        """Return the speeds [rad/s], shape (2,), at `time` [s] without the waiting commands."""
        return np.zeros(INPUT_SIZE) if self._followed is None else self._followed.at(time)

    def _took_effect(self, index: int, is_late: bool, time: float, speeds: Vector) -> None:
        """Record that a command is followed by `time` [s], when the rotors had these speeds."""
        passed = [self._waiting.popleft() for _ in range(index + 1)]
        hold = passed[-1][0]
        delay, was_withdrawn = 0.0, passed[-1][1]
        for _, is_lost in passed[:-1]:
            if is_lost:
                self._losses.append(1.0)
        self._losses.append(0.0)
        if is_late:
            measured = [*self._between, (time, speeds)][: len(self._between) or 1]
            began = self._began(hold, *measured[0])
            delay = began - hold.start
            if was_withdrawn or delay > self._negligible:
                for withdrawn, _ in passed:
                    self._sent.withdraw(withdrawn)
                known = [(began, self._speeds_before(began)), *measured]
                self._sent.follow(hold, known, self._acceleration)
                self.delay = delay
        self._known += 1
        self._delays.append(delay if delay > self._negligible else 0.0)
        self._followed = hold
        self._between = []

    def _began(self, hold: FirstOrderHold, time: float, speeds: Vector) -> float:
        """Return when the rotors left the command before, from measured speeds [rad/s].

        They then accelerate as fast as they can.
        """
        took = _distance(speeds, self._speeds_before(time)) / self._acceleration
        return max(hold.start, min(time - took, np.nextafter(time, -np.inf)))

    @property
    def _negligible(self) -> float:
        """Delay up to which a command counts as in time [s]."""
        spacing = min(self._gaps, default=0.0)
        return max(NEGLIGIBLE, _MAX_DELAY_SPACINGS * spacing)

    def _overdue(self, due: list[int], time: float) -> None:
        """Withdraw commands that are not followed at `time` [s] though they should be."""
        self._between = []
        for i in due:
            hold, is_late = self._waiting[i]
            if not is_late and time - hold.start > self._negligible:
                self._sent.withdraw(hold)
                self._waiting[i] = (hold, True)


def _distance(one: Vector, other: Vector) -> float:
    return float(np.max(np.abs(one - other)))
