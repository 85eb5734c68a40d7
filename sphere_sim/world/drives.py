# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Drives of the rotors: the command in force, its time-out, limits of speed and acceleration."""

import math
from collections.abc import Mapping

import numpy as np

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector

PLANNED_LIMITS = (
    "max_rotor_speed", "max_rotor_acceleration", "max_rotor_torque", "rotor_axial_inertia"
)
"""Parameters of a controller's robot that determine what its plans demand of the drives."""


class CommandFollower:
    """Conversion of timed commands into rotor speeds within the limits of the drives.

    A trajectory in force has priority; without one the newest rotor speeds are followed until
    their time-out, and then the rotors ramp to rest. A new command replaces the previous one and
    is never queued; a late one is evaluated at the present time. Rotor speeds that arrive within
    `command_timeout` after the end of a trajectory are late samples of it and are ignored.

    The limits are in rad/s and rad/s^2; `command_timeout` [s] is how long rotor speeds without a
    time stamp are followed.
    """

    def __init__(self, max_speed: float, max_acceleration: float, command_timeout: float) -> None:
        self._max_speed = max_speed
        self._max_acceleration = max_acceleration
        self._timeout = command_timeout
        self.clamped = 0
        """Number of commands beyond the largest rotor speed."""
        self.reset()

    def reset(self) -> None:
        """Discard all commands."""
        self._trajectory: FirstOrderHold | None = None
        self._speeds: Vector = np.zeros(INPUT_SIZE)
        self._speeds_time = -np.inf

    def follow_trajectory(self, hold: FirstOrderHold) -> None:
        """Follow a first-order hold to its end; its knot times are simulated times [s]."""
        self.clamped += int(np.any(np.abs(hold.speeds) > self._max_speed + 1e-9))
        self._trajectory = hold

    def is_newer(self, hold: FirstOrderHold) -> bool:
        """Return whether a hold starts no earlier than the previous one."""
        return self._trajectory is None or hold.start >= self._trajectory.start

    def has_followed(self, hold: FirstOrderHold) -> bool:
        """Return whether the newest trajectory is this one: the other may be a copy of it."""
        newest = self._trajectory
        return newest is not None and (
            np.array_equal(newest.times, hold.times) and np.array_equal(newest.speeds, hold.speeds)
        )

    def follow_speeds(self, speeds: Vector, time: float) -> None:
        """Follow rotor speeds [rad/s], two finite numbers, received at `time` [s]."""
        given = np.asarray(speeds, dtype=float)
        if given.shape != (INPUT_SIZE,) or not np.all(np.isfinite(given)):
            raise InvalidInputError(
                "rotor speeds", given.tolist(), "two finite numbers [rad/s]"
            )
        self.clamped += int(np.any(np.abs(given) > self._max_speed + 1e-9))
        self._speeds, self._speeds_time = given, time

    def commanded(self, time: float) -> Vector:
        """Return the commanded rotor speeds at `time` [rad/s]; zero without a command in force."""
        trajectory = self._trajectory
        if trajectory is not None and time <= trajectory.end + 1e-9:
            return trajectory.at(time)
        alone_from = -np.inf if trajectory is None else trajectory.end + self._timeout
        if alone_from < self._speeds_time and time <= self._speeds_time + self._timeout:
            return self._speeds
        return np.zeros(INPUT_SIZE)

    def speeds_after(self, speeds: Vector, time: float, duration: float) -> Vector:
        """Return the rotor speeds (2,) [rad/s] at the end of a short step, within the limits.

        `speeds` are those at its start `time` [s], `duration` is its length [s].
        """
        reach = self._max_acceleration * duration
        target = self.commanded(time + duration)
        # Not np.clip, which takes five times as long: this runs in every step.
        target = np.minimum(np.maximum(target, -self._max_speed), self._max_speed)
        return np.minimum(np.maximum(target, speeds - reach), speeds + reach)

    def knots_between(self, start: float, end: float) -> list[float]:
        """Return the knot times of the trajectory strictly between `start` and `end` [s]."""
        trajectory = self._trajectory
        return [] if trajectory is None else trajectory.knots_between(start + 1e-9, end - 1e-9)


def beyond(
    robot: RobotParameters, planned: Mapping[str, float], controller: str,
    torque_limit: float = math.inf, plant: str = "",
) -> str:
    """Return in one line which limits of the robot plans exceed; empty if there are none.

    `planned` are the values of `PLANNED_LIMITS` in the node `controller`, `torque_limit` is the
    largest torque of a drive [N m] in the settings of the plant of that name.
    """
    speed, acceleration = planned["max_rotor_speed"], planned["max_rotor_acceleration"]
    torque, inertia = planned["max_rotor_torque"], planned["rotor_axial_inertia"]
    if torque > 0.0 and inertia > 0.0:
        acceleration = min(acceleration, torque / inertia)
    attained = torque_limit / robot.rotor_axial_inertia
    figures = (
        ("robot.max_rotor_speed", speed, robot.max_rotor_speed, "rad/s", "as in this node"),
        ("robot.max_rotor_acceleration", acceleration, robot.max_rotor_acceleration, "rad/s^2",
         "as in this node"),
        ("robot.max_rotor_acceleration", acceleration, attained, "rad/s^2",
         f"for {plant}.torque_limit = {torque_limit:g} N m"),
    )
    return "; ".join(
        f"{name}: given {wanted:g} {unit} in {controller}, expected at most {given:g} {unit}, "
        f"{why}"
        for name, wanted, given, unit, why in figures
        if wanted > given * (1.0 + 1e-9)
    )
