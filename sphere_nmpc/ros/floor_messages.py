# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the floor, from and to its cells and polygons, in their serialised form.

What cannot be read or used raises an `InvalidInputError` or an `InvalidMapError`.
"""

import array
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PolygonInstanceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import serialize_message

from sphere_nmpc.floor.occupancy import (
    MOST_CELLS,
    MOST_CORNERS,
    Grid,
    InvalidMapError,
    grid_of_values,
)
from sphere_nmpc.model.state import QUATERNION, upright_state
from sphere_nmpc.ros.messages import message_object, stamp_to_ros

CellsOf = Callable[[float, bool], Grid]
"""Returns the cells of a map, given the share [-] from which on one is occupied, and whether
unknown ones are free."""


LARGEST_MAP = MOST_CELLS + 1000, f"{MOST_CELLS} cells"
"""Size of the largest map [bytes], header included, and what that suffices for."""
LARGEST_KEEPOUT = 12 * MOST_CORNERS + 1000, f"{MOST_CORNERS} corners"
"""Size of the largest area to keep out of [bytes], header included, and what that suffices for."""


def map_of_message(raw: bytes, frame: str) -> CellsOf:
    """Return the cells of a serialised OccupancyGrid in a frame or without one."""
    message = message_object(raw, OccupancyGrid)
    _check_frame("map", message, frame)
    info = message.info
    place, turn = info.origin.position, info.origin.orientation
    origin = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
    values = np.asarray(message.data, dtype=np.int8)
    return partial(grid_of_values, values, info.width, info.height, info.resolution, origin)


def keepout_of_message(
    message: PolygonInstanceStamped, frame: str
) -> tuple[int, list[tuple[float, float]]]:
    """Return the id of an area in a frame or without one, and its corners as they are [m].

    There are none in a message that removes the area.
    """
    _check_frame("keepout", message, frame)
    points = message.polygon.polygon.points
    return int(message.polygon.id), [(point.x, point.y) for point in points]


def floor_message(grid: Grid | None, stamp: int, frame: str) -> bytes:
    """Return an OccupancyGrid of values 0 and 100 with a stamp [ns]; one of no cells for None."""
    message = OccupancyGrid()
    message.header.frame_id = frame
    message.header.stamp = message.info.map_load_time = stamp_to_ros(stamp)
    origin = message.info.origin
    if grid is not None:
        message.info.height, message.info.width = grid.occupied.shape
        message.info.resolution = grid.resolution
        origin.position.x, origin.position.y, _ = grid.origin
        turn = origin.orientation
        turn.w, turn.x, turn.y, turn.z = upright_state(*grid.origin)[QUATERNION].tolist()
        # An array is taken over as it is; of anything else rclpy checks each number.
        message.data = array.array("b", (grid.occupied.view(np.int8) * np.int8(100)).tobytes())
    return bytes(serialize_message(message))


def _check_frame(name: str, message: Any, frame: str) -> None:
    given = message.header.frame_id
    if given not in ("", frame):
        raise InvalidMapError(name, f"frame {given}", f"'{frame}' (world_frame) or none")
