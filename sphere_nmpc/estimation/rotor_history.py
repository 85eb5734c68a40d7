# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""History of the rotor speeds: commands as sent, and as measured speeds correct them."""

import math
from collections import deque

import numpy as np

from sphere_nmpc.estimation.posterior import SHARE_STEP
from sphere_nmpc.model.first_order_hold import SAME, SHORTEST, FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.reporting.recent import RECENT, Recent

_MAX_HOLDS = 2048
"""Holds remembered: two seconds at the highest control rate, a quarter of an hour at 2 Hz."""
_MAX_WAITING = 256
"""Newest commands that may still take effect: half a second of them at the highest rate."""
LONGEST_WINDOW = 0.3
"""Largest commitment window [s]: later commands count as lost, and after as long without measured
speeds none are awaited."""
_MIN_DIFFERENCE = 0.5
"""Difference of two commands above which measured speeds show which one is followed [rad/s]."""
_MAX_DISTANCE_RATIO = 0.5
"""Distance to the command that is followed over that to the other one, below which it is clear."""
NEGLIGIBLE = 0.025
"""Delay of a command up to which it counts as in time [s; of its motion for the robot of Table 1].
That of one late by 0.1 s is up to 10 mm from the planned one, which grows with the square of the
delay, and a plan that is followed has a margin of 2.1 mm."""
_MAX_DELAY_SPACINGS = 1.25
"""Delay up to which a command also counts as in time [spacings of the measurements]: a clock that
is a topic has the same spacing, and commands are late by that alone."""


class RotorHistory:
    """Holds in the order in which they took effect; each lasts until the next one.

    They are kept as they were sent, and as measured rotor speeds correct them: a command that
    these do not show to be followed is withdrawn; where it takes effect later it is entered again
    from then on. So a command that is late or lost on its way is taken neither for another plant
    nor for momentum.

    What is read are the holds as sent, until measured speeds have followed a command, or poses
    show that they explain the motion better; where poses show the opposite it is the former again,
    see `judge`.

    Times are control times [s].

    Parameters
    ----------
    acceleration : float, optional
        Limit of the rotors' acceleration, by which they catch up with a late command [rad/s^2].
    """

    def __init__(self, acceleration: float = math.inf) -> None:
        self._acceleration = acceleration
        self._sent: deque[FirstOrderHold] = deque(maxlen=_MAX_HOLDS)
        self._corrected: deque[FirstOrderHold] = deque(maxlen=_MAX_HOLDS)
        self._holds = self._sent
        self._doubt = 0.0
        """Twice the log of the odds that the corrections are wrong."""
        self.contradicted = False
        """Whether the motion contradicts the measured rotor speeds."""
        self.is_measured = False
        """Whether there have been measured speeds."""
        self.delays, self.losses = Recent(), Recent()
        """Delays of the newest commands, 0 of those in time [s], and 1 for each that was lost."""
        self.delay = math.nan
        """Delay of the newest late command from sending to its effect [s]; nan without any."""
        self.reset()

    def clear(self) -> None:
        """Discard all holds; the rotors count as at rest, and what is known of delays is kept."""
        self._sent.clear()
        self._corrected.clear()
        self.reset()

    def reset(self) -> None:
        """Take what was sent as followed; await measured speeds of further commands."""
        self._followed: FirstOrderHold | None = None
        self._waiting: deque[tuple[FirstOrderHold, bool]] = deque(maxlen=_MAX_WAITING)
        """Commands that have not been followed yet, and whether they are withdrawn."""
        self._measured: tuple[float, Vector] = (-math.inf, np.zeros(INPUT_SIZE))
        self._between: list[tuple[float, Vector]] = []
        """Speeds measured while the rotors leave one command and do not follow the next yet."""
        self._gaps = Recent()
        self.resume()

    def resume(self) -> None:
        """Ask for measured speeds again, as the link may be another one."""
        self._known = 0

    @property
    def is_known(self) -> bool:
        """Whether enough commands have been followed to know how late they are."""
        return self._known >= RECENT

    @property
    def condition(self) -> Condition | None:
        """The warning about measured speeds that are not used; None without one."""
        if not self.contradicted:
            return None
        return Condition(
            Kind.SPEEDS_CONTRADICTED, "given speeds in joint_states by which the sphere would not "
            "have moved as its poses show, while the commands explain it, expected those of the "
            "rotors [rad/s] when they were measured; they are left out: are they always 0, in "
            "another unit, or stamped late?",
        )

    def record(self, hold: FirstOrderHold) -> None:
        """Add a hold that takes effect at its first knot and replaces what was sent for later."""
        enter(hold, self._sent, self._corrected)
        self._waiting.append((hold, False))

    def observe(self, time: float, speeds: Vector, lag: float = 0.0) -> None:
        """Take rotor speeds [rad/s], shape (2,), measured at `time` [s].

        `lag` is the delay of the rotors behind the speeds that their drives follow [s].
        """
        time -= lag
        since, before = self._measured
        if time <= since:
            return
        self._measured, self.is_measured = (time, speeds), True
        if np.isfinite(since):
            self._gaps.append(time - since)
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
        if errors[best] <= _MIN_DIFFERENCE < float(np.max(np.abs(speeds))) and self._doubt == 0.0:
            self._holds = self._corrected  # unless poses show more
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
        hold, was_withdrawn = passed[-1]
        delay = 0.0
        self.losses.extend(1.0 for _, is_lost in passed[:-1] if is_lost)
        self.losses.append(0.0)
        if is_late:
            measured = [*self._between, (time, speeds)][: len(self._between) or 1]
            began = self._began(hold, *measured[0])
            delay = began - hold.start
            if was_withdrawn or delay > self._negligible:
                for withdrawn, _ in passed:
                    self._withdraw(withdrawn)
                self._follow(hold, [(began, self._speeds_before(began)), *measured])
                self.delay = delay
        self._known += 1
        self.delays.append(delay if delay > self._negligible else 0.0)
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
        return max(NEGLIGIBLE, _MAX_DELAY_SPACINGS * min(self._gaps, default=0.0))

    def _overdue(self, due: list[int], time: float) -> None:
        """Withdraw commands that are not followed at `time` [s] though they should be."""
        self._between = []
        for i in due:
            hold, is_late = self._waiting[i]
            if not is_late and time - hold.start > self._negligible:
                self._withdraw(hold)
                self._waiting[i] = (hold, True)

    def _withdraw(self, hold: FirstOrderHold) -> None:
        """Correct by a hold that did not take effect; the one before it lasts longer."""
        if hold in self._corrected:
            self._corrected.remove(hold)

    def _follow(self, hold: FirstOrderHold, known: list[tuple[float, Vector]]) -> None:
        """Correct by a hold that took effect late and is not in force yet.

        `known` are times [s] and the rotor speeds then [rad/s], shape (2,), first those at which
        the hold before was left; then the rotors catch up.
        """
        time, speeds = known[-1]
        corrected = self._corrected
        rest = hold.starting_at(time, speeds).limited(np.inf, self._acceleration)
        times, before = zip(*known[:-1], strict=True)
        followed = FirstOrderHold(
            np.concatenate((times, rest.times)), np.vstack((*before, rest.speeds))
        )
        earlier = [kept for kept in corrected if kept.start < followed.start]
        later = [kept for kept in corrected if kept.start > time]
        corrected.clear()
        corrected.extend((*earlier, followed, *later))

    @property
    def believes_measured(self) -> bool:
        """Whether what is read is corrected by the measured speeds."""
        return self._holds is self._corrected

    def judge(self, as_sent: float, as_corrected: float, improbable: float) -> None:
        """Take into account how far a motion was from its prediction by the speeds of each kind.

        Given are normalised squares of innovations with 5 degrees of freedom. The scale of the
        errors is not known, so that -2 log of the ratio of likelihoods is 5 log of that of the
        mean squares, 1 being that of noise alone. The ratios of intervals multiply, up to odds of
        `improbable`; once these are reached the one or the other is believed, until the opposite
        ones are (a sequential test). A motion for which both are the same halves the odds that
        the corrections are wrong.
        """
        more = 5.0 * math.log((5.0 + as_corrected) / (5.0 + as_sent))
        if more:
            self._doubt = min(max(self._doubt + more, -improbable), improbable)
        elif self._doubt > 0.0:
            self._doubt = max(self._doubt - 2.0 * math.log(2.0), 0.0)
        self.contradicted = self._doubt == improbable or (self.contradicted and self._doubt > 0.0)
        if abs(self._doubt) == improbable:
            self._holds = self._sent if self.contradicted else self._corrected

    def is_pending(self, time: float, now: float) -> bool:
        """Return whether measured speeds will show soon what the rotors did up to `time` [s].

        Not if none were received for a while at `now` [s].
        """
        return now - LONGEST_WINDOW < self._measured[0] < time - SHORTEST

    @property
    def newest(self) -> FirstOrderHold | None:
        """The hold in force, None before the first."""
        return self._holds[-1] if self._holds else None

    def at(self, time: float) -> Vector:
        """Return the speeds in force at `time` [rad/s], shape (2,); zero before the first."""
        for hold in reversed(self._holds):
            if hold.start <= time + SAME:
                return hold.at(time)
        return np.zeros(INPUT_SIZE)

    def leading_to(self, hold: FirstOrderHold, now: float) -> FirstOrderHold:
        """Return the speeds from `now` on [s] if `hold` is sent.

        Until the hold begins, the one in force is followed with all its knots, as the plan
        assumed. A hold that has begun already is joined at its next knot.
        """
        joined = hold.starting_at(now, self.at(now))
        newest = self.newest
        if newest is None:
            return joined
        knots = newest.knots_between(now + SHORTEST, hold.start - SHORTEST)
        if not knots:
            return joined
        speeds = np.array([newest.at(t) for t in knots])
        return FirstOrderHold(
            np.insert(joined.times, 1, knots), np.insert(joined.speeds, 1, speeds, axis=0)
        )

    def pieces(self, start: float, end: float) -> tuple[Vector, Vector]:
        """Return the speeds sent from `start` to `end` [s], which is later, as straight pieces.

        That is their lengths [s], shape (K,), and the rotor speeds at their ends [rad/s], shape
        (K + 1, 2). Before the first hold the rotors are at rest.
        """
        times, speeds = knots_of(self._holds, start, end)
        return np.diff(times), speeds

    def both_pieces(self, start: float, end: float) -> list[tuple[Vector, Vector]]:
        """Return the pieces by what was sent, and by what measured speeds make of it."""
        both = (knots_of(holds, start, end) for holds in (self._sent, self._corrected))
        return [(np.diff(times), speeds) for times, speeds in both]

    def moves_after(self, time: float) -> bool:
        """Return whether the hold in force has a speed other than zero at `time` [s] or later."""
        newest = self.newest
        if newest is None:
            return False
        return bool(newest.at(time).any() or newest.speeds[newest.times > time].any())


def enter(hold: FirstOrderHold, *histories: deque[FirstOrderHold]) -> None:
    """Add a hold to histories, in which it replaces those that begin no earlier."""
    for holds in histories:
        while holds and holds[-1].start >= hold.start:
            holds.pop()
        holds.append(hold)


def knots_of(holds: deque[FirstOrderHold], start: float, end: float) -> tuple[Vector, Vector]:
    """Return the knots of holds in force from `start` to `end` [s], with these two.

    That is their times [s], shape (K,), and the rotor speeds then [rad/s], shape (K, 2). Each hold
    lasts until the next one; before the first one the rotors are at rest.
    """
    times, speeds = [end], list[Vector]()
    at_start: Vector = np.zeros(INPUT_SIZE)
    # From the newest back, so that a long history costs nothing.
    for hold in reversed(holds):
        begun, until = hold.start, times[-1]
        if begun > end + SAME:
            continue
        speeds = speeds or [hold.at(end)]
        since = max(start, begun)
        if since < until:
            knots = [*reversed(hold.knots_between(since, until)), since]
            times += knots
            speeds += map(hold.at, knots)
        if begun <= start + SAME:
            at_start = speeds[-1]
            break
    if times[-1] > start:
        times.append(start)
        speeds = [*(speeds or [at_start]), at_start]
    return np.array(times[::-1]), np.array(speeds[::-1])


def _distance(one: Vector, other: Vector) -> float:
    return float(np.max(np.abs(one - other)))
