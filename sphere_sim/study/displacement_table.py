# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time lost on the way in one direction, by orientation at one end: a table of the package.

It is the complement of the largest displacement S of docs/time_bound.md: within t a sphere that
starts in an orientation gets at most FASTEST (t - lost time) far. Times and lengths are in the
units of that document, in which the table depends on the ratios of the inertias alone.

Let m be the horizontal axis about which the sphere rolls in the direction of interest and k the
vertical, both in body axes. They and so the orientation, but for the heading, follow from latitude
l and longitude p of m on the body and the angle a of k about m, measured from north towards east:

    m = [cos l cos p, cos l sin p, sin l],   k = cos a north + sin a east.
"""

import functools
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector

FASTEST = math.sqrt(2.0)
"""Largest speed, that of rolling with both rotors at their limit."""
FILE = Path(__file__).with_name("displacement_table.npz")
"""Table of the default robot; `bench/documents/displacement_table_file.py` writes it."""
RESOLUTION = 1e-3
"""Unit of the lost times that are stored, rounded down."""
_SAME_RATIO = 1e-12
"""Rounding of the ratios of the inertias."""


class DisplacementTable:
    """Lost times of a robot.

    The nodes of a grid of `stored`, (times, latitudes, longitudes, angles), are half a step from
    the limits of the angles; those of the latitude end before the pole, about which all
    orientations lose `at_cap`. Between nodes it is a quadratic B-spline, whose weights are not
    negative and add up to one: with smaller coefficients it is a bound as well.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Ascending, from zero.
    """

    def __init__(self, times: Vector, at_cap: Vector, stored: NDArray[np.int16]) -> None:
        self.times = times
        self._at_cap, self._stored = at_cap, stored
        self._step = 0.5 * math.pi / stored.shape[2]

    def lost(self, quaternion: Vector, heading: float) -> Vector:
        """Return the least lost time [1 / (c1 u_max)] at each of `times`, shape (n,).

        It is that on the way from an orientation in the direction of a heading [rad].
        """
        # Later on it is not less, as nothing is faster than FASTEST.
        return np.maximum.accumulate(np.maximum(self._lost(quaternion, heading), 0.0))

    def _lost(self, quaternion: Vector, heading: float) -> Vector:
        latitude, *_ = angles = angles_of(quaternion, heading)
        rows, longitudes, turns = self._stored.shape[1:]
        if latitude >= (rows - 1) * self._step:
            return self._at_cap
        place = angles / self._step - 0.5
        node = np.floor(place + 0.5).astype(int)
        offset = place - node
        before, after = 0.5 - offset, 0.5 + offset
        weights = np.array((0.5 * before**2, 0.75 - offset**2, 0.5 * after**2))
        total = np.zeros(len(self.times))
        for shift in np.ndindex(3, 3, 3):
            row, longitude, turn = node + shift - 1
            if row < 0:
                row, longitude = -1 - row, -1 - longitude
            stored = self._stored[:, row, longitude % longitudes, turn % turns]
            weight = math.prod(weights[shift[axis], axis] for axis in range(3))
            total += weight * RESOLUTION * stored
        return total

    def least_time(self, distance: float, start: Vector, goal: Vector, heading: float) -> float:
        """Return a time [1 / (c1 u_max)] in which no motion gets so far at full rotor speeds.

        The distance is in radii of the shell, start and goal are quaternions, and the heading
        from start to goal is in radian. The part of the motion after any instant is one back from
        the goal.
        """
        first, last = self.lost(start, heading), self.lost(goal, heading + math.pi)
        ways = [FASTEST * (self.times - lost) for lost in (first, last)]
        # The rest of the way is not faster than straight rolling.
        possible = ways[0][:, None] + ways[1] <= distance
        lost = np.where(possible, first[:, None] + last, 0.0)
        return distance / FASTEST + float(np.max(lost))


def angles_of(quaternion: Vector, heading: float) -> Vector:
    """Return latitude, longitude and angle, shape (3,), of an orientation.

    `heading` is that of the direction of interest [rad]; the latitude is not below the equator.
    """
    turn = rotation.matrix(quaternion)
    # The sphere rolls about the horizontal axis to the left of the direction.
    axis = turn.T @ (-math.sin(heading), math.cos(heading), 0.0)
    vertical = turn[2]
    if axis[2] < 0.0:
        axis, vertical = axis * (1.0, -1.0, -1.0), vertical * (1.0, -1.0, -1.0)
    longitude = math.atan2(axis[1], axis[0])
    latitude = math.atan2(axis[2], math.hypot(axis[0], axis[1]))
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    angle = math.atan2(vertical @ east, vertical @ np.cross(axis, east))
    return np.array([latitude, longitude, angle])


def displacement_table(constants: LumpedConstants) -> DisplacementTable | None:
    """Return the table of a robot; None where its inertias are in other ratios than the file's."""
    ratios, table = _table()
    own = (constants.transverse_ratio, constants.axial_ratio)
    return table if np.allclose(own, ratios, rtol=0.0, atol=_SAME_RATIO) else None


@functools.cache
def _table() -> tuple[Vector, DisplacementTable]:
    """Return the ratios and the table of the file.

    It has the changes from time to time, and of these, modulo 256, the ones from angle to angle.
    """
    with np.load(FILE, allow_pickle=False) as file:
        changes = np.cumsum(file["slopes"], axis=3, dtype=np.int8)
        stored = np.cumsum(changes, axis=0, dtype=np.int16)
        return file["ratios"], DisplacementTable(file["times"], file["at_cap"], stored)
