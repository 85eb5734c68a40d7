# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands that stop the rotors, or keep the sphere at rest with momentum."""

import numpy as np

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import INPUT_SIZE, Vector

SATURATED = "rest: the rotors cannot hold the momentum, they stay at their limits"
"""What is given up where a rotor would have to exceed its limit."""
_SPACING = 0.25
"""Spacing of the knots along which a command follows the momentum [s]; on a slope the speeds of
rest change linearly, and an imbalance turns with the sphere, which rests."""


def speeds_of_rest(drift: Drift, quaternion: Vector, max_speed: float) -> Vector:
    """Return the speeds that hold the momentum, clipped to the limit [rad/s], shape (2,)."""
    if drift.is_zero:
        return np.zeros(INPUT_SIZE)
    held: Vector = np.minimum(
        np.maximum(drift.rest_speeds(quaternion), -max_speed), max_speed
    )
    return held


def is_saturated(drift: Drift, quaternion: Vector, max_speed: float) -> bool:
    """Return whether a rotor would have to exceed its limit to hold the momentum."""
    return not drift.is_zero and bool(np.max(np.abs(drift.rest_speeds(quaternion))) > max_speed)


def hold_momentum(
    hold: FirstOrderHold, drift: Drift, quaternion: Vector, max_speed: float, duration: float
) -> FirstOrderHold:
    """Return the hold, extended to keep the sphere at rest for `duration` [s].

    Parameters
    ----------
    hold : FirstOrderHold
        Rotor speeds to the arrival.
    drift : Drift
        Drift at its end.
    quaternion : ndarray, shape (4,)
        Orientation of the rest.
    max_speed : float
        Limit of the rotor speeds [rad/s].
    duration : float
        Time for which the momentum is held [s].
    """
    steps = max(1, round(duration / _SPACING))
    after = [duration * (i + 1) / steps for i in range(steps)]
    speeds = [
        speeds_of_rest(drift.after_rest(quaternion, time), quaternion, max_speed) for time in after
    ]
    return FirstOrderHold(
        np.concatenate((hold.times, hold.end + np.array(after))), np.vstack((hold.speeds, speeds))
    )


def ramp_to(
    time: float, speeds: Vector, target: Vector, max_acceleration: float
) -> FirstOrderHold:
    """Return the ramp between two rotor speeds, which both rotors end at the same time.

    Parameters
    ----------
    time : float
        Start of the ramp [s].
    speeds, target : ndarray, shape (2,)
        Rotor speeds at its start and end [rad/s].
    max_acceleration : float
        Largest rotor acceleration [rad/s^2].
    """
    ramp = FirstOrderHold.ramp_to_rest(time, speeds - target, max_acceleration)
    return FirstOrderHold(ramp.times, ramp.speeds + target)
