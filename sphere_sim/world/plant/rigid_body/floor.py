# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rough floor: a random height field, the same for the same seed.

SciPy is imported where it is used: loading takes a third of a second and a plane does not need it.
"""

import math
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

_CELLS_PER_WAVELENGTH = 10
_MAX_CELLS = 1000
"""Largest number of cells along one side, so that no settings need gigabytes of memory."""


@dataclass(frozen=True, eq=False)
class RoughFloor:
    """Height field on a square grid about the origin.

    Attributes
    ----------
    heights : ndarray, shape (n, n)
        Height above the lowest point [m]; rows along y, columns along x.
    extent : float
        Half the side of the square [m].
    """

    heights: Vector
    extent: float

    @property
    def span(self) -> float:
        """Height of the highest point [m]."""
        return float(self.heights.max())

    def resting_height(self, x: float, y: float, radius: float) -> float:
        """Return the height of the centre of a sphere that touches the floor in one point [m].

        Parameters
        ----------
        x, y : float
            Position of its centre [m].
        radius : float
            Its radius [m].
        """
        from scipy.ndimage import map_coordinates

        # The field is low, so that the contact is near the lowest point of the sphere.
        reach = min(radius, 2.0 * math.sqrt(2.0 * radius * self.span) + 1e-3)
        offsets = np.linspace(-reach, reach, 121)
        dx, dy = np.meshgrid(offsets, offsets)
        inside = dx**2 + dy**2 < reach**2
        dx, dy = dx[inside], dy[inside]
        cells = self.heights.shape[0] - 1
        scale = cells / (2.0 * self.extent)
        at = np.vstack((y + dy + self.extent, x + dx + self.extent)) * scale
        floor = map_coordinates(self.heights, at, order=1, mode="constant", cval=0.0)
        return float(np.max(floor + np.sqrt(radius**2 - dx**2 - dy**2)))


def make_floor(settings: RigidBodySettings) -> RoughFloor | None:
    """Return a random rough floor, or None for a plane."""
    if settings.floor_roughness == 0.0:
        return None
    from scipy.ndimage import gaussian_filter

    cell = settings.floor_wavelength / _CELLS_PER_WAVELENGTH
    cells = min(_MAX_CELLS, math.ceil(2.0 * settings.floor_extent / cell))
    noise = np.random.default_rng(settings.floor_seed).normal(size=(cells + 1, cells + 1))
    # A Gaussian filter of this width makes bumps at distances of about a wavelength.
    width = settings.floor_wavelength / 4.0 * cells / (2.0 * settings.floor_extent)
    smooth = gaussian_filter(noise, width, mode="wrap")
    heights = smooth * (settings.floor_roughness / smooth.std())
    return RoughFloor(heights - heights.min(), settings.floor_extent)
