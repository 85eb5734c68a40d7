# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the floor: map file, edge, what counts as occupied, and the clearance from it."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.map_file import read_map
from sphere_nmpc.floor.occupancy import MOST_CORNERS, check_polygon
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import quantity, validate

_LONGEST = 64 * MOST_CORNERS
"""Characters of an edge: two numbers of 20 digits and some space for each corner."""


@dataclass(frozen=True)
class OccupancySettings:
    """What is occupied of the floor that the sphere rolls on; without map and edge nothing is."""

    map_file: str = quantity(
        "", "-", "Map file (YAML of map_server with PGM or PNG) that is used until a map is "
        "received; none if empty", live=True,
    )
    floor: str = quantity(
        "", "m", "Corners of the polygon in which the sphere has to stay, such as "
        "[[0, 0], [4, 0], [4, 3], [0, 3]]; none if empty", live=True,
    )
    unknown_is_free: bool = quantity(
        False, "-", "Whether the sphere may touch cells of unknown occupancy", live=True
    )
    occupied_threshold: float = quantity(
        0.65, "-", "Occupancy from which on a cell of a map is occupied", minimum=0.01,
        maximum=1.0, live=True,
    )

    def __post_init__(self) -> None:
        validate(self)
        self.edge()

    def edge(self) -> Vector | None:
        """Return the corners of the edge, shape (K, 2) [m]; None without one."""
        return _edge_of(self.floor) if self.floor.strip() else None

    def layers(self) -> Layers:
        """Return map and edge; `InvalidMapError` is raised if the file cannot be used."""
        grid = None
        if self.map_file:
            found = read_map(Path(self.map_file))
            grid = found.grid(self.occupied_threshold, self.unknown_is_free)
        return Layers(grid, self.edge())


@dataclass(frozen=True)
class FloorSettings(OccupancySettings):
    """What is occupied of the floor, and how far the sphere has to stay away from it."""

    clearance: float = quantity(
        0.03, "m", "Least distance between the sphere and what is occupied", minimum=0.0,
        maximum=100.0, live=True,
    )

    def whole(self, radius: float) -> Floor:
        """Return the floor of a sphere of a radius [m], empty without map and edge."""
        grid = self.layers().grid(radius)
        return Floor.EMPTY if grid is None else Floor(grid, radius, self.clearance)


@lru_cache(maxsize=2)  # a change is checked more than once
def _edge_of(text: str) -> Vector:
    """Return the corners of an edge, shape (K, 2) [m], as they were given."""
    if len(text) > _LONGEST:
        raise InvalidParameterError("floor", text, f"at most {_LONGEST} characters")
    try:
        corners = [(float(x), float(y)) for x, y in json.loads(text)]
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InvalidParameterError(
            "floor", text, "corners such as [[0, 0], [4, 0], [4, 3], [0, 3]]"
        ) from None
    edge = check_polygon("floor", corners)
    edge.flags.writeable = False
    return edge
