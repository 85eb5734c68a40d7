# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Poses that are given or measured elsewhere: what is known of them, and of their tilt."""

import math
from typing import NamedTuple

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import CONTRADICTING_DEVIATIONS, with_block
from sphere_nmpc.model.state import QUATERNION, Vector

LEAST_DEVIATION = 1e-6
"""Least standard deviation of a given pose [m, rad], for which its covariance stays regular."""
MOST_VARIANCE = (1e6, math.pi**2)
"""Largest variances of a given position [m^2] and rotation [rad^2]: more is not known at all."""
_NEARLY = 0.2
"""Angle within which a vertical is the opposite one [rad]."""
_OPPOSITE = "; or has the accelerometer the opposite sign?"


class Fix(NamedTuple):
    """A pose that was measured elsewhere."""

    time: float
    """Time of measurement [s]."""
    pose: Vector
    """Position [m] and quaternion wxyz, shape (6,)."""
    covariance: Vector
    """Covariance of the error in the world frame, shape (5, 5)."""
    replaces: bool = False
    """Whether it replaces the pose rather than being averaged with it."""


def bounded(covariance: Vector) -> Vector:
    """Return a covariance, shape (5, 5), with variances that are not beyond what is unknown."""
    most = np.array([MOST_VARIANCE[0]] * 2 + [MOST_VARIANCE[1]] * 3)
    shrunk = np.sqrt(most / np.maximum(np.diag(covariance), most))
    # Larger ones first, as the products of others with them may overflow.
    found: Vector = shrunk[:, None] * covariance * shrunk
    return found


def has_tilt(covariance: Vector) -> bool:
    """Return whether a pose with a covariance, (5, 5), has a tilt: RViz and AMCL send 0 for it."""
    return float(np.trace(covariance[2:4, 2:4])) >= 4.0 * LEAST_DEVIATION**2


def with_vertical(given: Fix, vertical: Vector, tilt: Vector) -> Fix:
    """Return a given pose with a vertical in the body, (3,), and the covariance of that, (2, 2).

    The heading is that of the shortest rotation between both verticals.
    """
    stated = rotation.vertical(given.pose[QUATERNION])
    axis = np.cross(vertical, stated).astype(float)
    length = float(np.linalg.norm(axis))
    between = math.atan2(length, float(stated @ vertical))
    if length < 1e-9:
        axis, length = np.array((1.0, 0.0, 0.0)), 1.0
    q = rotation.product(given.pose[QUATERNION], rotation.exponential(axis * (between / length)))
    covariance = with_block(given.covariance, slice(2, 4), tilt)
    pose = np.concatenate((given.pose[:2], q / math.sqrt(float(q @ q))))
    return given._replace(pose=pose, covariance=covariance)


def contradiction(given: Fix, vertical: Vector, spread: float) -> tuple[str, bool]:
    """Return in one line how gravity contradicts the tilt of a given pose, "" where it does not.

    Also whether it is the opposite, as with an accelerometer of the other sign.

    `vertical` is that in the body frame as gravity shows it, shape (3,), and `spread` its standard
    deviation [rad].
    """
    stated = rotation.vertical(given.pose[QUATERNION])
    between = rotation.between(vertical, stated)
    known = float(np.trace(given.covariance[2:4, 2:4]))
    allowed = CONTRADICTING_DEVIATIONS * math.sqrt(known + spread**2)
    if between <= allowed or not has_tilt(given.covariance):
        return "", False
    is_opposite = between > math.pi - _NEARLY
    return (
        f"given a pose whose vertical is {math.degrees(between):.1f} deg from that "
        f"of the accelerometer, expected at most {math.degrees(allowed):.1f} deg; "
        f"position and heading are taken{_OPPOSITE if is_opposite else ''}"
    ), is_opposite
