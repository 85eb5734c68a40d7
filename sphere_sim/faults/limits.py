# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether commands and rotors keep the limits of the drives, judged from what was published."""

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector

TOLERANCE = 1e-3
"""Share by which a limit may be passed before it counts as broken."""
CONTINUITY = 1e-3
"""Largest jump of the commanded speeds from one command to the next [rad/s]."""
_RESOLUTION = 2e-9
"""What a duration may lose when its two stamps are rounded to nanoseconds [s]."""
_KEPT = 20
"""Broken limits that are kept word for word."""


class LimitCheck:
    """Watch trajectories, rotor commands and joint states.

    Parameters
    ----------
    max_speed : float
        Largest rotor speed [rad/s].
    max_acceleration : float
        Largest rotor acceleration [rad/s^2].
    """

    def __init__(self, max_speed: float, max_acceleration: float) -> None:
        self._max_speed = max_speed
        self._max_acceleration = max_acceleration
        self.continuous = True
        """Whether a command has to start from the speeds in force."""
        self.forget()
        self.begin()

    def begin(self) -> None:
        """Start to count anew."""
        self.worst_speed = 0.0
        """Largest speed, commanded or turned [rad/s]."""
        self.worst_slew = 0.0
        """Largest slew, commanded or turned [rad/s^2]."""
        self.broken: list[str] = []
        """What broke a limit, in words."""

    def forget(self) -> None:
        """Forget what was commanded and turned, as when time starts anew."""
        self._hold: FirstOrderHold | None = None
        self._turned: tuple[int, Vector] | None = None

    def trajectory(self, hold: FirstOrderHold) -> None:
        """Judge a commanded hold, alone and against the one it replaces."""
        self._judge_speed("rotor_trajectory", hold.speeds)
        if hold.times.size > 1:
            changes = np.abs(np.diff(hold.speeds, axis=0))
            durations = np.diff(hold.times)[:, None] + _RESOLUTION
            self._judge_slew("rotor_trajectory", float(np.max(changes / durations)))
        before, self._hold = self._hold, hold
        if before is None or hold.start < before.start or not self.continuous:
            return
        jump = float(np.max(np.abs(hold.speeds[0] - before.at(hold.start))))
        if jump > CONTINUITY + self._max_acceleration * _RESOLUTION:
            self._tell(
                f"rotor_trajectory starts {jump:.4g} rad/s away from the one in force at "
                f"t = {hold.start:.3f} s"
            )

    def command(self, speeds: Vector) -> None:
        """Judge rotor speeds that were commanded without a time, shape (2,)."""
        self._judge_speed("rotor_commands", speeds)

    def joints(self, stamp: int, speeds: Vector) -> None:
        """Judge the speeds, shape (2,), at which the rotors turned at `stamp` [ns]."""
        self._judge_speed("joint_states", speeds)
        before, self._turned = self._turned, (stamp, speeds)
        if before is None or stamp <= before[0]:
            return
        duration = (stamp - before[0]) * 1e-9 + _RESOLUTION
        self._judge_slew("joint_states", float(np.max(np.abs(speeds - before[1]))) / duration)

    def _judge_speed(self, topic: str, speeds: Vector) -> None:
        speed = float(np.max(np.abs(speeds), initial=0.0))
        if not np.all(np.isfinite(speeds)):
            self._tell(f"{topic} holds {np.asarray(speeds).tolist()}")
            return
        self.worst_speed = max(self.worst_speed, speed)
        if speed > self._max_speed * (1.0 + TOLERANCE):
            self._tell(f"{topic} asks for {speed:.6g} rad/s")

    def _judge_slew(self, topic: str, slew: float) -> None:
        self.worst_slew = max(self.worst_slew, slew)
        if slew > self._max_acceleration * (1.0 + TOLERANCE):
            self._tell(f"{topic} asks for {slew:.6g} rad/s^2")

    def _tell(self, what: str) -> None:
        if len(self.broken) < _KEPT:
            self.broken.append(what)
