# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the floor as its cells and polygons.

What cannot be read or used raises an `InvalidInputError` or an `InvalidMapError`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from sphere_nmpc.floor.occupancy import (
    MOST_CELLS,
    MOST_CORNERS,
    Grid,
    InvalidMapError,
    grid_of_values,
)
from sphere_nmpc.ros.cdr import OccupancyGrid, fields

CellsOf = Callable[[float, bool], Grid]
"""Returns the cells of a map, given the share [-] from which on one is occupied, and whether
unknown ones are free."""


LARGEST_MAP = MOST_CELLS + 1000, f"{MOST_CELLS} cells"
"""Size of the largest map [bytes], header included, and what that suffices for."""
LARGEST_KEEPOUT = 12 * MOST_CORNERS + 1000, f"{MOST_CORNERS} corners"
"""Size of the largest area to keep out of [bytes], header included, and what that suffices for."""


def map_of_message(raw: bytes, frame: str) -> CellsOf:
    """Return the cells of a serialised OccupancyGrid in a frame or without one."""
    _, given, _, (resolution,), (width, height), origin, cells = fields(raw, OccupancyGrid)
    _check_frame("map", given, frame)
    return partial(grid_of_values, cells, width, height, resolution, origin)


def floor_of(message: OccupancyGrid) -> Grid | None:
    """Return the floor that a controller reports; None where it has no cells, so is free.

    `InvalidMapError` is raised where the message is not valid.
    """
    if not any(message.size):
        return None
    # The controller has decided already what counts as occupied.
    (resolution,), (width, height) = message.resolution, message.size
    return grid_of_values(message.cells, width, height, resolution, message.origin, 0.5, False)


def keepout_of_message(message: Any, frame: str) -> tuple[int, list[tuple[float, float]]]:
    """Return the id of a PolygonInstanceStamped, as `map_of_message`, and its corners [m].

    There are none in a message that removes the area.
    """
    _check_frame("keepout", message.header.frame_id, frame)
    points = message.polygon.polygon.points
    return int(message.polygon.id), [(point.x, point.y) for point in points]


def _check_frame(name: str, given: str, frame: str) -> None:
    if given not in ("", frame):
        raise InvalidMapError(name, f"frame {given}", f"'{frame}' (world_frame) or none")
