# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Saturation of the rotors of a sphere that rests with momentum on a slope or out of balance.

At rest the orientation does not change, so the momentum that the rotors hold grows linearly.
"""

import math

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.rotation import Vector


def time_to_saturation(drift: Drift, quaternion: Vector, max_speed: float) -> float:
    """Return the time that the sphere can rest until a rotor is at its limit [s].

    It is the least t >= 0 with |(R^T (h + t dh/dt))_i| = `max_speed` for a rotor i.

    Parameters
    ----------
    drift : Drift
        Momentum at present, slope and imbalance.
    quaternion : ndarray, shape (4,)
        Orientation of the rest [-; body to world].
    max_speed : float
        Largest rotor speed [rad/s].

    Returns
    -------
    float
        Time [s]; 0 if a rotor is at its limit or beyond, inf if none ever reaches it.
    """
    gained = rotation.matrix(quaternion).T @ drift.torque_at_rest(quaternion)
    times = (
        _time_to_limit(float(speed), float(rate), max_speed)
        for speed, rate in zip(drift.rest_speeds(quaternion), gained[:2], strict=True)
    )
    return min(times)


def _time_to_limit(speed: float, rate: float, limit: float) -> float:
    """Return the least t >= 0 with |speed + t rate| >= limit."""
    if abs(speed) >= limit:
        return 0.0
    if rate == 0.0:
        return math.inf
    return (math.copysign(limit, rate) - speed) / rate
