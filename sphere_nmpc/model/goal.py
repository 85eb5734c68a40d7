# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals: a position, and of the orientation all, all but the heading, or nothing.

A goal that leaves something free is a set of poses. `nearest` returns the member of it to which
the distance is measured, with `state_error` and the others of `sphere_nmpc.model.state`.
"""

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.state import POSE, POSITION, QUATERNION, Vector, upright_state

STANDING: Vector = np.zeros(5)
"""Rate of a goal that does not move."""
STANDING.flags.writeable = False


def moved(pose: Vector, rate: Vector, elapsed: float) -> Vector:
    """Return a pose, shape (6,), that has changed for a time [s] at a constant rate, shape (5,).

    The rate is that of an error of `sphere_nmpc.model.error_state` [m/s; world, rad/s; body].
    """
    return apply_error(pose, elapsed * rate) if rate.any() else pose


class Orientation(Enum):
    """What a goal demands of the orientation."""

    FULL = "full"
    """All of it."""
    ANY_HEADING = "any_heading"
    """All but a turn about the vertical: the same point of the shell touches the floor."""
    ANY = "any"
    """Nothing."""

    @property
    def weights(self) -> Vector:
        """Weights of a small turn from a member about the world's axes [-], shape (3,)."""
        return _WEIGHTS[self]

    @property
    def remark(self) -> str:
        """What is said of a goal beside its numbers; empty for a whole pose."""
        return _REMARKS[self]

    def nearest_of(self, pose: Vector, states: Vector) -> Vector:
        """Return the member nearest to each of the rows of `states`, shape (K, 6); see `nearest`.

        It takes the same time for a recording as `nearest` for a few states.
        """
        members = np.tile(pose, (len(states), 1))
        if self is Orientation.FULL:
            return members
        turns = states[:, QUATERNION].T
        if self is Orientation.ANY_HEADING:
            turns = rotation.products(turns, rotation.conjugate(pose[QUATERNION]))
            turns[1:3] = 0.0
            lengths = np.linalg.norm(turns, axis=0)
            turns[:, lengths < _UPSIDE_DOWN_COSINE] = [[1.0], [0.0], [0.0], [0.0]]
            turns = rotation.products(turns / np.linalg.norm(turns, axis=0), pose[QUATERNION])
        members[:, QUATERNION] = turns.T
        return members

    def draw(self, rng: np.random.Generator, pose: Vector, count: int) -> Vector:
        """Draw members of the set with `pose`, shape (6,); the one for all if it is the only one.

        Returns
        -------
        ndarray, shape (6, count), or (6, 1)
        """
        if self is Orientation.FULL:
            return pose[:, None]
        turns = rng.standard_normal((4, count))
        if self is Orientation.ANY_HEADING:
            turns[1:3] = 0.0
        turns /= np.linalg.norm(turns, axis=0)
        places = np.broadcast_to(pose[POSITION, None], (2, count))
        return np.concatenate((places, rotation.products(turns, pose[QUATERNION])))

    def nearest(self, pose: Vector, state: Vector) -> Vector:
        """Return the member nearest to `state`, (6,) or (9,), of the set with `pose`, (6,)."""
        if self is Orientation.FULL:
            return pose
        quaternion = state[QUATERNION]
        if self is Orientation.ANY_HEADING:
            between = rotation.product(quaternion, rotation.conjugate(pose[QUATERNION]))
            turn = between * (1.0, 0.0, 0.0, 1.0)
            length = float(np.linalg.norm(turn))
            if length < _UPSIDE_DOWN_COSINE:
                return pose
            quaternion = rotation.product(turn / length, pose[QUATERNION])
        return np.concatenate((pose[POSITION], quaternion))


_WEIGHTS = {
    Orientation.FULL: np.ones(3),
    Orientation.ANY_HEADING: np.array((1.0, 1.0, 0.0)),
    Orientation.ANY: np.zeros(3),
}
_REMARKS = {
    Orientation.FULL: "",
    Orientation.ANY_HEADING: "any heading",
    Orientation.ANY: "position only",
}
_UPSIDE_DOWN_COSINE = 1e-9
"""Cosine of half the tilt [-] below which the body is upside down, and all headings as near."""


@dataclass(frozen=True, eq=False)
class Goal:
    """Goal of the sphere.

    Attributes
    ----------
    pose : ndarray, shape (6,)
        Goal state, or a member of the set.
    orientation : Orientation
        What it demands of the orientation.
    rate : ndarray, shape (5,)
        Rate of change of the pose, see `moved`.
    since : float
        Control time at which it is at `pose` [s].
    """

    pose: Vector
    orientation: Orientation = Orientation.FULL
    rate: Vector = field(default_factory=lambda: STANDING)
    since: float = 0.0

    @classmethod
    def position(cls, x: float, y: float) -> "Goal":
        """Return the goal of a place [m], with any orientation."""
        return cls(upright_state(x, y), Orientation.ANY)

    @classmethod
    def upright(cls, x: float, y: float, heading: float | None = None) -> "Goal":
        """Return the goal of an upright sphere at a place [m], with a heading [rad] or any."""
        if heading is None:
            return cls(upright_state(x, y), Orientation.ANY_HEADING)
        return cls(upright_state(x, y, heading))

    def at(self, time: float) -> Vector:
        """Return the pose at a control time [s], shape (6,)."""
        if self.rate is STANDING:  # as at nearly every sample
            return self.pose
        return moved(self.pose, self.rate, time - self.since)

    def now(self, time: float) -> "Goal":
        """Return the same goal with its pose at a control time [s]."""
        if self.rate is STANDING or not self.rate.any():
            return self
        return replace(self, pose=self.at(time), since=time)

    def nearest(self, state: Vector, time: float) -> Vector:
        """Return the member at a time [s] that is nearest to a state, (6,) or (9,); shape (6,)."""
        return self.orientation.nearest(self.at(time), state)

    def __str__(self) -> str:
        shown = self.pose[POSITION if self.orientation is Orientation.ANY else POSE]
        numbers = str([round(float(v), 4) for v in shown])
        return ", ".join(filter(None, (numbers, self.orientation.remark)))

    def equals(self, other: "Goal") -> bool:
        """Return whether it is the same set of poses, given in the same way."""
        same = self.orientation is other.orientation
        counts = POSITION if self.orientation is Orientation.ANY else POSE
        return same and np.array_equal(self.pose[counts], other.pose[counts])
