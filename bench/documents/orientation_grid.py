# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Grid of orientations in angles in which rolling along x and all symmetries are simple.

The angles are those of `sphere_sim.study.displacement_table`, in radian, with m, k, l, p and a;
time is in units of 1 / (c1 u_max), lengths in those of the shell's radius. Body rates per unit of
time are those of rotor speeds of +-u_max; proof: docs/time_bound.md.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sphere_nmpc.model.state import Vector

INPUTS = ((1.0, 1.0), (1.0, -1.0))
"""Rotor speeds over u_max that matter, with their opposites: the corners of the limits."""
_POLE = 0.2
"""Distance of the last row from the pole m = +-z [rad], where longitude and angle are singular."""


class Rates(NamedTuple):
    """Rates with one of `INPUTS`, arrays of one shape."""

    displacement: Vector
    """Speed in the direction of interest, omega . m."""
    latitude: Vector
    longitude: Vector
    angle: Vector


class OrientationGrid:
    """Nodes of latitude, longitude and angle, `size` of them in a quarter turn.

    Half a turn of k about m, quarter turns about the body's z axis and half turns about its x axis
    change nothing, so that l and p from 0 to pi / 2 and a from 0 to pi suffice. Beyond the equator
    (l, p) stands for (-l, -p). Nodes are half a step from the limits; rows of latitude end before
    the pole.

    Attributes
    ----------
    step : float
        Step of all three angles [rad].
    shape : tuple of int
        Number of nodes by latitude, longitude and angle.
    """

    def __init__(self, size: int, transverse_ratio: float, axial_ratio: float) -> None:
        self.transverse_ratio, self.axial_ratio = transverse_ratio, axial_ratio
        self.step = 0.5 * math.pi / size
        rows = int((0.5 * math.pi - _POLE) / self.step) + 1
        self.shape: tuple[int, ...] = (rows, size, 2 * size)
        self.size = math.prod(self.shape)

    @property
    def latitudes(self) -> Vector:
        """Latitudes of the rows of nodes."""
        return np.asarray((np.arange(self.shape[0]) + 0.5) * self.step)

    def nodes(self) -> Sequence[Vector]:
        """Return latitude, longitude and angle of the nodes, each of the grid's shape."""
        places = ((np.arange(number) + 0.5) * self.step for number in self.shape)
        return np.meshgrid(*places, indexing="ij")

    def centres(self) -> Sequence[Vector]:
        """Return the angles of the centres between nodes, each of the grid's shape.

        Centre [i, j, k] is between nodes i - 1 and i, j and j + 1, k and k + 1.
        """
        places = (np.arange(number) * self.step for number in self.shape)
        latitude, longitude, angle = np.meshgrid(*places, indexing="ij")
        return latitude, longitude + self.step, angle + self.step

    def rates(self, inputs: tuple[float, float], angles: Sequence[Vector] | Vector) -> Rates:
        """Return the rates at latitudes, longitudes and angles."""
        r1, r3 = self.transverse_ratio, self.axial_ratio
        latitude, longitude, angle = angles
        sine, cosine = np.sin(latitude), np.cos(latitude)
        to_north, to_east = np.cos(angle), np.sin(angle)
        # Inputs along the outward and the eastward horizontal of the body at this longitude.
        outward = inputs[0] * np.cos(longitude) + inputs[1] * np.sin(longitude)
        eastward = inputs[1] * np.cos(longitude) - inputs[0] * np.sin(longitude)
        third = to_north * cosine
        turn = (to_east * eastward - to_north * sine * outward) / (
            1.0 - r1 + (r1 - r3) * third * third
        )
        about = -cosine * outward - (r3 - r1) * third * sine * turn
        east = -eastward - r1 * to_east * turn
        north = sine * outward - (r1 * to_north + (r3 - r1) * third * cosine) * turn
        return Rates(about, east, -north / cosine, about - sine / cosine * north)

    def mirrored(self, values: Vector) -> Vector:
        """Return values at the nodes with the row beyond the equator in front."""
        return np.concatenate((values[:1, ::-1], values))

    def smoothed(self, values: Vector, stride: int = 1) -> Vector:
        """Return averages of values at the nodes and at those `stride` steps from them.

        Near the pole, where meridians are close, those with a stride of one are over more nodes of
        equal turn of k.
        """
        rows = self.shape[0]
        south = np.concatenate((values[stride - 1 :: -1, ::-1], values))[:rows]
        beyond = (2.0 * values[-1] - values[rows - 2 - more] for more in range(stride))
        north = np.concatenate((values[stride:], np.stack(list(beyond))))
        values = 0.25 * (south + north) + 0.5 * values
        for axis in (1, 2):
            around = np.roll(values, stride, axis) + np.roll(values, -stride, axis)
            values = 0.25 * around + 0.5 * values
        if stride > 1:
            return values
        # On a meridian and its neighbour the same turn of k differs by one step of the angle.
        needed = np.tan(self.latitudes) ** 2
        variance = 1.0
        while variance <= needed[-1]:
            first = int(np.searchsorted(needed, variance))
            part = values[first:]
            around = np.roll(part, (stride, stride), (1, 2))
            around += np.roll(part, (-stride, -stride), (1, 2))
            values[first:] = 0.25 * around + 0.5 * part
            stride *= 2
            variance += stride**2
        return values
