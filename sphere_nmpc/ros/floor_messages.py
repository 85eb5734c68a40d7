# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the floor, from and to its cells and polygons, in their serialised form.

What cannot be read or used raises an `InvalidInputError` or an `InvalidMapError`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from sphere_nmpc.floor.occupancy import (
    MOST_CELLS,
    MOST_CORNERS,
    Grid,
    InvalidMapError,
    grid_of_values,
)
from sphere_nmpc.model.state import QUATERNION, upright_state
from sphere_nmpc.ros.cdr import OccupancyGrid, grid_message, read

CellsOf = Callable[[float, bool], Grid]
"""Returns the cells of a map, given the share [-] from which on one is occupied, and whether
unknown ones are free."""


LARGEST_MAP = MOST_CELLS + 1000, f"{MOST_CELLS} cells"
"""Size of the largest map [bytes], header included, and what that suffices for."""
LARGEST_KEEPOUT = 12 * MOST_CORNERS + 1000, f"{MOST_CORNERS} corners"
"""Size of the largest area to keep out of [bytes], header included, and what that suffices for."""
_NOWHERE = (0.0,) * 6 + (1.0,)
"""Pose of the corner of a map of no cells."""


def map_of_message(raw: bytes, frame: str) -> CellsOf:
    """Return the cells of a serialised OccupancyGrid in a frame or without one."""
    message = read(raw, OccupancyGrid)
    _check_frame("map", message.frame, frame)
    return _cells_of(message)


def floor_of(message: OccupancyGrid) -> Grid | None:
    """Return the floor that a controller reports; None where it has no cells, so is free."""
    # The controller has decided already what counts as occupied.
    return _cells_of(message)(0.5, False) if any(message.size) else None


def keepout_of_message(
    message: Any, frame: str
) -> tuple[int, list[tuple[float, float]]]:
    """Return the id of a PolygonInstanceStamped, as `map_of_message`, and its corners [m].

    There are none in a message that removes the area.
    """
    _check_frame("keepout", message.header.frame_id, frame)
    points = message.polygon.polygon.points
    return int(message.polygon.id), [(point.x, point.y) for point in points]


def floor_message(grid: Grid | None, stamp: int, frame: str) -> bytes:
    """Return an OccupancyGrid of values 0 and 100 with a stamp [ns]; one of no cells for None."""
    if grid is None:
        return grid_message(np.empty((0, 0), np.int8), 0.0, _NOWHERE, stamp, frame)
    x, y, _ = grid.origin
    qw, qx, qy, qz = upright_state(*grid.origin)[QUATERNION].tolist()
    cells = grid.occupied.view(np.int8) * np.int8(100)
    return grid_message(cells, grid.resolution, (x, y, 0.0, qx, qy, qz, qw), stamp, frame)


def _cells_of(message: OccupancyGrid) -> CellsOf:
    (resolution,) = message.resolution
    return partial(
        grid_of_values, np.asarray(message.cells, dtype=np.int8), *message.size, resolution,
        message.origin,
    )


def _check_frame(name: str, given: str, frame: str) -> None:
    if given not in ("", frame):
        raise InvalidMapError(name, f"frame {given}", f"'{frame}' (world_frame) or none")
