# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Judge of the contacts of the sphere with what is occupied on the floor in force."""

import numpy as np
from hostile import RADIUS

from sphere_nmpc.floor.floor import exact_distance
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import Vector

STOPPING = 0.5
"""Way [m] that a stop takes at most: a sampling period and the ramp of the rotors at the largest
speed, 0.742 m/s, and what the controller and this judge learn late."""
_TOUCH = 5e-3
"""Distance [m] below which the sphere counts as in contact: walls of the plant stop it millimetres
before, and any plan keeps more."""
_SAME = 1e-2
"""Decrease of the distance by which a new floor has come nearer to the sphere [m]."""


class ContactCheck:
    """Check that the sphere rolls into nothing that is in force.

    Where something comes into force nearer than the way of a stop, or over the sphere, a contact
    cannot be prevented; there it must not roll on for longer than that way.
    """

    def __init__(self) -> None:
        self.grid: Grid | None = None
        """What is occupied on the floor in force; None if nothing is."""
        self.begin()
        self._place: Vector | None = None
        self._left = 0.0

    def begin(self) -> None:
        """Reset the result, at the beginning of a trial."""
        self.excused = False
        """Whether something has come into force too near to be avoided."""

    def floor(self, grid: Grid | None) -> None:
        """Take a floor that has come into force."""
        before, self.grid = self._distance(), grid
        now = self._distance()
        if now < RADIUS + STOPPING and now < before - _SAME:
            self._left, self.excused = STOPPING, True

    def observe(self, place: Vector) -> str:
        """Return what is wrong about a place of the sphere, shape (2,) [m]; empty if nothing."""
        rolled = 0.0 if self._place is None else float(np.linalg.norm(place - self._place))
        self._place = place
        distance = self._distance()
        if distance >= RADIUS + STOPPING:
            self._left = 0.0
        if distance >= RADIUS + _TOUCH:
            return ""
        before, self._left = self._left, self._left - rolled
        if before < 0.0 or self._left >= 0.0:
            return ""  # once for each contact
        return (f"it rolled on in contact at {np.round(place, 3).tolist()} m, {distance:.3f} m "
                "from what is occupied")

    def restart(self) -> None:
        """Discard the place, as where the sphere is put elsewhere."""
        self._place = None

    def _distance(self) -> float:
        if self.grid is None or self._place is None:
            return float("inf")
        return exact_distance(self.grid, self._place, 2.0 * (RADIUS + STOPPING))
