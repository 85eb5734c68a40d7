# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Check of commands and rotor speeds against the limits of the drives."""

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector

TOLERANCE = 1e-3
"""Relative excess up to which a limit does not count as violated."""
CONTINUITY = 1e-3
"""Largest jump of the commanded speeds from one command to the next [rad/s]."""
_RESOLUTION = 2e-9
"""Largest error of a duration between two stamps that were rounded to nanoseconds [s]."""
_KEPT = 20
"""Number of violations that are kept as text."""

_LATE = 0.01
"""Delay of a command beyond which the drives have to catch up with it [s]."""


class LimitCheck:
    """Check of trajectories, rotor commands and joint states.

    Parameters
    ----------
    max_speed : float
        Largest rotor speed [rad/s].
    max_acceleration : float
        Largest rotor acceleration [rad/s^2].
    servo_error : float, optional
        Largest change of the servos' speed error that the load causes [rad/s], by which measured
        speeds may change more than commanded ones.
    """

    def __init__(
        self, max_speed: float, max_acceleration: float, servo_error: float = 0.0
    ) -> None:
        self._max_speed = max_speed
        self._max_acceleration = max_acceleration
        self._servo_error = servo_error
        self.continuous = True
        """Whether a command has to start from the speeds in force."""
        self.restart()
        self.begin()

    def begin(self) -> None:
        """Reset the results, at the beginning of a trial."""
        self.worst_speed = 0.0
        """Largest speed, commanded or measured [rad/s]."""
        self.worst_slew = 0.0
        """Largest slew rate, commanded or measured [rad/s^2]."""
        self.broken: list[str] = []
        """Violations of a limit, in words."""

    def restart(self) -> None:
        """Discard the previous command and speeds, as when simulated time restarts."""
        self._hold: FirstOrderHold | None = None
        self._left: FirstOrderHold | None = None
        self._measured: tuple[int, Vector] | None = None

    def trajectory(self, hold: FirstOrderHold) -> None:
        """Check a commanded hold by itself and against the one that it replaces."""
        self.sent(hold)
        self.delivered(hold)

    def sent(self, hold: FirstOrderHold) -> None:
        """Check a commanded hold by itself."""
        self._check_speed("rotor_trajectory", hold.speeds)
        if hold.times.size > 1:
            changes = np.abs(np.diff(hold.speeds, axis=0))
            durations = np.diff(hold.times)[:, None] + _RESOLUTION
            self._check_slew("rotor_trajectory", float(np.max(changes / durations)))

    def delivered(self, hold: FirstOrderHold, now: float = -np.inf) -> None:
        """Check a hold that reaches the drives by `now` [s] against the one that it replaces.

        After a hold that was late the rotors are still between the one that they left and that.
        A copy of the hold in force replaces nothing.
        """
        if self._hold is not None and _is_copy(hold, self._hold):
            return
        (before, left), self._hold = (self._hold, self._left), hold
        self._left = before if now > hold.start + _LATE else None
        if before is None or hold.start < before.start or not self.continuous:
            return
        in_force = [before.at(hold.start)]
        if left is not None:
            in_force.append(left.at(hold.start))
        within = np.clip(hold.speeds[0], np.min(in_force, axis=0), np.max(in_force, axis=0))
        jump = float(np.max(np.abs(hold.speeds[0] - within)))
        if jump > CONTINUITY + self._max_acceleration * _RESOLUTION:
            self._report(
                f"rotor_trajectory starts {jump:.4g} rad/s away from the one in force at "
                f"t = {hold.start:.3f} s"
            )

    def command(self, speeds: Vector) -> None:
        """Check rotor speeds that were commanded without a time, shape (2,)."""
        self._check_speed("rotor_commands", speeds)

    def joints(self, stamp: int, speeds: Vector) -> None:
        """Check the measured rotor speeds, shape (2,), at `stamp` [ns]."""
        self._check_speed("joint_states", speeds)
        before, self._measured = self._measured, (stamp, speeds)
        if before is None or stamp <= before[0]:
            return
        duration = (stamp - before[0]) * 1e-9 + _RESOLUTION
        change = float(np.max(np.abs(speeds - before[1])))
        self._check_slew("joint_states", change / duration, self._servo_error / duration)

    def _check_speed(self, topic: str, speeds: Vector) -> None:
        speed = float(np.max(np.abs(speeds), initial=0.0))
        if not np.all(np.isfinite(speeds)):
            self._report(f"{topic} holds {np.asarray(speeds).tolist()}")
            return
        self.worst_speed = max(self.worst_speed, speed)
        if speed > self._max_speed * (1.0 + TOLERANCE):
            self._report(f"{topic} has {speed:.6g} rad/s")

    def _check_slew(self, topic: str, slew: float, allowance: float = 0.0) -> None:
        self.worst_slew = max(self.worst_slew, slew)
        if slew > self._max_acceleration * (1.0 + TOLERANCE) + allowance:
            self._report(f"{topic} has {slew:.6g} rad/s^2")

    def _report(self, what: str) -> None:
        if len(self.broken) < _KEPT:
            self.broken.append(what)


def _is_copy(hold: FirstOrderHold, other: FirstOrderHold) -> bool:
    return np.array_equal(hold.times, other.times) and np.array_equal(hold.speeds, other.speeds)
