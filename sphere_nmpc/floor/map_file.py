# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Maps in files, as map_server of Nav2 saves them: YAML with the name of an image, PGM or PNG."""

import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.floor.occupancy import (
    MOST_CELLS,
    Grid,
    InvalidMapError,
    check_geometry,
    grid_of_values,
)
from sphere_nmpc.foreign_file import InvalidFileError, read_file
from sphere_nmpc.foreign_text import shown

_MOST_TEXT = 16_384
"""Bytes of the YAML file, which mostly has 150; its parser takes 0.1 s for that many."""
_DEEPEST = 2
"""Levels of its lists: the origin is one in a mapping."""
_MOST_IMAGE = 2 * MOST_CELLS + _MOST_TEXT
"""Bytes of the image: two for a pixel, which are as many as an uncompressed file has."""
_MOST_PLAIN = 20_000_000
"""Bytes of an image in decimal numbers, with which its decoder takes up to 5 s."""
_PLAIN = b"P2"
_MAGIC = (b"P5", _PLAIN, b"\x89PNG")
"""What images of the two formats begin with."""
_FORMATS = "a PGM or PNG file"
_OCCUPIED_THRESHOLD, _FREE_THRESHOLD = 0.65, 0.25
"""Thresholds of map_server where a file has none."""


@dataclass(frozen=True, eq=False)
class MapValues:
    """Values of a map, as a message of type nav_msgs/OccupancyGrid has them.

    Attributes
    ----------
    values : ndarray of int8, shape (H, W)
        0 to 100 per cent, -1 where unknown; row 0 is at the origin.
    resolution : float
        Side of a cell [m].
    origin : tuple of float
        Place [m] and heading [rad] of the first cell's corner.
    """

    values: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]

    def grid(self, occupied_threshold: float, unknown_is_free: bool) -> Grid:
        """Return the occupied cells; see `grid_of_values`."""
        height, width = self.values.shape
        x, y, yaw = self.origin
        pose = (x, y, 0.0, 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
        return grid_of_values(
            self.values.ravel(), width, height, self.resolution, pose, occupied_threshold,
            unknown_is_free,
        )


def read_map(path: Path) -> MapValues:
    """Read a map file of mode trinary.

    Parameters
    ----------
    path : Path
        YAML file with image (relative to it), resolution [m], origin (x, y [m], yaw [rad]),
        negate, occupied_thresh and free_thresh.

    Raises
    ------
    InvalidMapError
        If a file cannot be read, or an entry is missing or not what it has to be.
    """
    name = f"map file {path}"
    try:
        return _read(name, Path(path))
    except InvalidMapError:
        raise
    except InvalidFileError as error:
        raise InvalidMapError(name, error.given, error.expected) from None
    except Exception as error:  # parsers and decoders raise many kinds for a broken file
        raise InvalidMapError(name, shown(error), "a YAML file of map_server") from None


def _read(name: str, path: Path) -> MapValues:
    import yaml

    text = read_file(path, _MOST_TEXT).decode("utf-8")
    depth = 0
    for event in yaml.parse(text):
        # A few lines of aliases of aliases are a value that no memory can hold, and the parser
        # takes minutes for thousands of brackets.
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST or isinstance(event, yaml.AliasEvent):
            what = "an alias" if depth <= _DEEPEST else "lists in lists"
            raise InvalidMapError(name, what, "a YAML file of map_server, which has none")
    entries = yaml.safe_load(text)
    if not isinstance(entries, dict):
        raise InvalidMapError(name, type(entries).__name__, "a mapping with image, resolution ...")
    mode = entries.get("mode", "trinary")
    if mode != "trinary":
        raise InvalidMapError(name, f"mode {mode!r}", "trinary")
    resolution = _number(name, entries, "resolution")
    origin = _origin(name, entries)
    negate = bool(_number(name, entries, "negate", 0.0))
    occupied = _number(name, entries, "occupied_thresh", _OCCUPIED_THRESHOLD)
    free = _number(name, entries, "free_thresh", _FREE_THRESHOLD)
    if not 0.0 <= free <= occupied <= 1.0:
        raise InvalidMapError(
            name, f"free_thresh {free:g} and occupied_thresh {occupied:g}",
            "0 <= free_thresh <= occupied_thresh <= 1",
        )
    image = entries.get("image")
    if not isinstance(image, str) or not image:
        raise InvalidMapError(name, f"image {image!r}", "the name of a PGM or PNG file")
    place = (*origin[:2], 0.0, 0.0, 0.0, math.sin(0.5 * origin[2]), math.cos(0.5 * origin[2]))

    def check(width: int, height: int) -> None:
        check_geometry(name, width, height, resolution, place)

    pixels, white = _pixels(name, path.parent / image, check)
    # In images black is 0, and row 0 at the top.
    levels = np.arange(white + 1, dtype=np.float32) / np.float32(white)
    shares = levels if negate else 1.0 - levels
    values = np.full(shares.shape, -1, dtype=np.int8)
    values[shares < free] = 0
    values[shares > occupied] = 100
    return MapValues(np.take(values, pixels[::-1], mode="clip"), resolution, origin)


def _pixels(
    name: str, image: Path, check: Callable[[int, int], None]
) -> tuple[NDArray[np.integer], int]:
    """Return the brightness of an image's pixels, shape (H, W), and that of white.

    `check` takes the numbers of columns and rows, and raises an error for those that are refused.
    """
    from PIL import Image

    # Larger images than the limit of Pillow are refused by their size.
    Image.MAX_IMAGE_PIXELS, limit = None, Image.MAX_IMAGE_PIXELS
    try:
        content = read_file(image, _MOST_IMAGE)
        if not content.startswith(_MAGIC):
            raise InvalidMapError(name, f"image {image}: {shown(content[:8])}", _FORMATS)
        if content.startswith(_PLAIN) and len(content) > _MOST_PLAIN:
            raise InvalidMapError(
                name, f"an image of {len(content)} bytes in decimal numbers",
                f"at most {_MOST_PLAIN}; a binary one (P5) is smaller",
            )
        with Image.open(io.BytesIO(content), formats=("PPM", "PNG")) as opened:
            check(*opened.size)
            is_deep = opened.mode.startswith("I")
            pixels = np.asarray(opened if is_deep else opened.convert("L"))
    except InvalidMapError:
        raise
    except InvalidFileError as error:
        raise InvalidMapError(name, f"image {image}: {error.given}", error.expected) from None
    except Exception as error:
        raise InvalidMapError(name, f"image {image}: {shown(error)}", _FORMATS) from None
    finally:
        Image.MAX_IMAGE_PIXELS = limit
    return pixels, 65535 if is_deep else 255


def _number(name: str, entries: dict[str, Any], key: str, default: float | None = None) -> float:
    given = entries.get(key, default)
    if isinstance(given, bool):
        given = float(given)
    if not isinstance(given, int | float) or not math.isfinite(given):
        shown = "no " + key if given is None else f"{key} {given!r}"
        raise InvalidMapError(name, shown, "a finite number")
    return float(given)


def _origin(name: str, entries: dict[str, Any]) -> tuple[float, float, float]:
    given = entries.get("origin")
    if not isinstance(given, list) or len(given) != 3:
        raise InvalidMapError(name, f"origin {given!r}", "[x, y, yaw]")
    x, y, yaw = (_number(name, {"origin": value}, "origin") for value in given)
    return x, y, yaw
