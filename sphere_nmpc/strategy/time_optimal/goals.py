# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals that are aimed at in place of a given one, at which the rotors cannot hold the momentum.

A sphere that rests out of balance gains momentum until a rotor saturates. The torque turns with
the sphere, so that an orientation at which it opposes the momentum unloads the rotors. They hold
the momentum there, too, if it is perpendicular to the body's z axis and to the imbalance; the
torque is largest where the imbalance is horizontal.
"""

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import after_slope, rest_speeds
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.rest import given_up_angle, holdable_goal
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_LEAST_MOMENTUM = 10.0
"""Momentum [rad/s] below which its direction is no longer followed."""
_LEAST_DIRECTED = 0.5
"""Cosine of the angle from the last direction of the momentum [-] beyond which it is no longer
followed."""


class HeldGoal:
    """Replacement of a goal that the rotors cannot hold, at present or for long.

    Parameters
    ----------
    max_speed : float
        Limit of the rotor speeds [rad/s].
    settings : TimeOptimalSettings
        When rotors are unloaded, and for how long.
    """

    def __init__(self, max_speed: float, settings: TimeOptimalSettings) -> None:
        self._max_speed = max_speed
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget the goal that unloads the rotors."""
        self._unloading: Vector | None = None
        self._direction: Vector = np.zeros(3)
        self.given_up = ""
        """What is given up of the goal and why; empty where nothing is."""

    def goal(
        self, situation: Situation, end: Vector | None, holding: bool, found_none: bool = False
    ) -> Vector:
        """Return the goal to aim at, shape (6,): the given object where that can be held.

        Parameters
        ----------
        situation : Situation
            With the final goal.
        end : ndarray of shape (3,), or None
            Predicted momentum at the arrival of the plan that is followed; None without one.
        holding : bool
            Whether the sphere rests at the goal.
        found_none : bool, optional
            Whether the last search has found no arrival; another orientation that unloads the
            rotors is then aimed at.
        """
        goal = situation.goal
        self.given_up = ""
        unloading = self._unloading_near(situation, holding)
        if unloading is not None:
            self.given_up = "orientation for a while: it unloads the rotors"
            momentum = situation.momentum if end is None else end
            self._follow(momentum)
            self._unloading = _unloading_orientation(
                situation.disturbance.imbalance, self._direction, unloading, found_none
            )
            return np.concatenate((goal[:2], self._unloading))
        if situation.has_small_momentum:
            return goal  # what may be an error of the estimate is no reason to leave
        if end is None:
            end = self._expected(situation, holding)
        found = holdable_goal(goal, end, situation.disturbance)
        if found is not goal and situation.orientation is not Orientation.ANY:
            self.given_up = given_up_angle(angle_error(found, goal))
        return found

    def _expected(self, situation: Situation, holding: bool) -> Vector:
        """Return the momentum to be expected at the arrival of a new plan, shape (3,)."""
        if holding:
            return situation.momentum
        if situation.is_out_of_balance:
            # The plan ends without momentum along the body's z axis; the torque has to be held.
            return np.zeros(3)
        way = float(np.linalg.norm(situation.goal[:2] - situation.state[:2]))
        duration = SteadyRolling.of(situation.constants, self._max_speed).duration(way)
        return after_slope(situation.momentum, situation.disturbance, duration)

    def _unloading_near(self, situation: Situation, holding: bool) -> Vector | None:
        """Return the orientation, shape (4,), near which the rotors are being unloaded.

        None while they are not; unloading begins and ends here.
        """
        settings, momentum = self._settings, situation.momentum
        if not situation.disturbance.imbalance.any():
            self._unloading = None
        elif self._unloading is not None:
            if float(self._direction @ momentum) <= 0.0:
                self._unloading = None
        elif holding:
            quaternion = situation.goal[QUATERNION]
            speeds = rest_speeds(momentum, quaternion)
            rates = rest_speeds(situation.disturbance.at_rest(quaternion), quaternion)
            nearly = settings.unloading_share * self._max_speed
            # One that is being unloaded by the torque at the goal itself needs no manoeuvre.
            if np.any((np.abs(speeds) > nearly) & (speeds * rates > 0.0)):
                self._begin(situation, quaternion)
        return self._unloading

    def _begin(self, situation: Situation, quaternion: Vector) -> None:
        """Begin to unload the rotors unless a slope loads them faster than that unloads them."""
        level, disturbance = situation.momentum * (1.0, 1.0, 0.0), situation.disturbance
        self._direction = level / np.linalg.norm(level)
        unload = float(np.linalg.norm(disturbance.imbalance))
        if float(self._direction[:2] @ disturbance.slope) < unload:
            self._unloading = quaternion

    def _follow(self, momentum: Vector) -> None:
        """Follow the direction of the momentum that is unloaded."""
        level = momentum * (1.0, 1.0, 0.0)
        length = float(np.linalg.norm(level))
        # Near zero the direction is not defined, and the momentum then reverses along it.
        if float(level @ self._direction) > _LEAST_DIRECTED * length and length > _LEAST_MOMENTUM:
            self._direction = level / length


def _unloading_orientation(
    imbalance: Vector, direction: Vector, near: Vector, other: bool
) -> Vector:
    """Return the orientation whose torque opposes a momentum along `direction` the most.

    The torque e3 x (R a) is largest where R a is horizontal. The momentum lies along the body
    axis that is perpendicular to z and the imbalance, in either sense: the one nearer to `near`,
    or the `other` one.
    """
    unit = imbalance / np.linalg.norm(imbalance)
    axis = np.cross([0.0, 0.0, 1.0], unit)
    length = float(np.linalg.norm(axis))
    axis = np.array([1.0, 0.0, 0.0]) if length < 1e-6 else axis / length
    body = np.column_stack((axis, unit, np.cross(axis, unit)))
    out = np.cross([0.0, 0.0, 1.0], direction)
    found = []
    for along in (direction, -direction):
        world = np.column_stack((along, out, np.cross(along, out)))
        found.append(rotation.from_matrix(world @ body.T))
    nearer, farther = sorted(found, key=lambda q: float(rotation.angle_between(q, near)))
    return farther if other else nearer
