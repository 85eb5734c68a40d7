# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The last pose of a run, with which the next one begins, and what contradicts it."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.estimation.odometry.pose_estimate import PoseEstimate
from sphere_nmpc.foreign.own_folder import KeptFile
from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import EXPECTED_DEVIATIONS
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, as_state

_TURNED = 0.1
"""Difference of rotor angles [rad] by which the rotors have turned meanwhile: the sphere of
Table 1 rolls by 0.5 mm."""
_ANYWHERE = np.array([1e3, 1e3, 1.8])
"""Standard deviations of position [m] and heading [rad] that are not known; of an angle of which
nothing is known it is 1.8 rad."""
_FREE = np.ix_([0, 1], [0, 1])
_TURN = slice(2, 5)


class KeptPose(NamedTuple):
    """What was known of the sphere when it was kept."""

    pose: Vector
    covariance: Vector
    """Covariance of the error of the pose, as in `PoseEstimate`."""
    is_at_rest: bool
    """Whether it rested, at a position that was known."""
    angles: Vector | None
    """Angles of the rotors [rad], shape (2,); None where they were not known."""

    def contradiction(self, age: float, found: PoseEstimate, angles: Vector | None) -> str:
        """Return why the sphere need not be where it was `age` [s] ago, in words; else "".

        `found` is the first estimate after a calibration that began with this one, and `angles`
        are those of the rotors now. Encoders that count from 0 again show nothing.
        """
        given = f"given the pose of {age:.0f} s ago at {self.pose[POSITION].round(2).tolist()} m"
        if not self.is_at_rest:
            return f"{given}, where the sphere moved, expected one at rest"
        before, now = (rotation.vertical(one[QUATERNION]) for one in (self.pose, found.pose))
        between = rotation.between(before, now)
        tilts = (_tilt(self.covariance, before), _tilt(found.covariance, now))
        # The bias is mostly the same.
        allowed = EXPECTED_DEVIATIONS * math.sqrt(sum(tilts))
        if between > allowed:
            return (
                f"{given}, whose vertical is {math.degrees(between):.1f} deg from that of the "
                f"accelerometer, expected at most {math.degrees(allowed):.1f} deg"
            )
        if self.angles is not None and angles is not None and np.abs(angles).max() > _TURNED and (
            np.abs(angles - self.angles).max() > _TURNED
        ):
            return (
                f"{given}, with rotors at {self.angles.round(2).tolist()} rad that are at "
                f"{angles.round(2).tolist()} rad now, expected them as they were"
            )
        return ""


def since(kept: KeptPose, age: float, pivoting: float, radius: float) -> Vector:
    """Return the covariance of a sphere that nothing seems to have moved for a time [s].

    It may have pivoted at a rate [rad/s], and rolled as far as its tilt does not show.
    """
    covariance = kept.covariance.copy()
    vertical = rotation.vertical(kept.pose[QUATERNION])
    covariance[_TURN, _TURN] += (pivoting * age) ** 2 * np.outer(vertical, vertical)
    covariance[_FREE] += radius**2 * _tilt(kept.covariance, vertical) * np.eye(2)
    return covariance


def anywhere(found: PoseEstimate) -> Vector:
    """Return the covariance of a pose of which the tilt alone is known."""
    vertical = rotation.vertical(found.pose[QUATERNION])
    covariance = np.zeros((5, 5))
    covariance[_FREE] = np.diag(_ANYWHERE[:2] ** 2)
    covariance[_TURN, _TURN] = found.covariance[_TURN, _TURN]
    covariance[_TURN, _TURN] += _ANYWHERE[2] ** 2 * np.outer(vertical, vertical)
    return covariance


def pose_memory(path: Path, keep: float) -> KeptFile[KeptPose]:
    """Return the file that keeps the last pose, for the time `keep` [s, wall]."""
    return KeptFile(path, keep, _content, _pose)


def _tilt(covariance: Vector, vertical: Vector) -> float:
    """Return the variance of the tilt [rad^2] by the covariance of a pose."""
    turn = covariance[_TURN, _TURN]
    return float(np.trace(turn) - vertical @ turn @ vertical)


def _content(kept: KeptPose) -> Mapping[str, Any]:
    return {
        "pose": kept.pose.tolist(), "covariance": kept.covariance.tolist(),
        "is_at_rest": kept.is_at_rest,
        "angles": None if kept.angles is None else kept.angles.tolist(),
    }


def _pose(content: Any) -> KeptPose:
    angles = content["angles"]
    covariance = np.array(content["covariance"], dtype=float).reshape(5, 5)
    known = None if angles is None else np.array(angles, dtype=float).reshape(2)
    is_sound = np.isfinite(covariance).all() and (np.linalg.eigvalsh(covariance) > -1e-9).all()
    if not is_sound or (known is not None and not np.isfinite(known).all()):
        raise InvalidStateError("kept pose", content, "finite numbers, and a covariance")
    return KeptPose(as_state(content["pose"]), covariance, bool(content["is_at_rest"]), known)
