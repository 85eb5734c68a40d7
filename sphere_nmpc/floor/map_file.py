# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Maps in files, as map_server of Nav2 loads them: YAML with the name of an image."""

import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import shown
from sphere_nmpc.floor.occupancy import (
    MOST_CELLS,
    Grid,
    InvalidMapError,
    check_geometry,
    grid_of_values,
)
from sphere_nmpc.foreign.file import InvalidFileError, find_file, read_file, yaml_texts

_MAX_TEXT_BYTES = 16_384
"""Bytes of the YAML file, which mostly has 150."""
_MAX_DEPTH = 2
"""Levels of its lists: the origin is one in a mapping."""
_MOST_IMAGE = 2 * MOST_CELLS + _MAX_TEXT_BYTES
"""Bytes of the image: two for a pixel, which are as many as an uncompressed file has."""
_MAX_PLAIN_BYTES = 20_000_000
"""Bytes of an image in decimal numbers, with which its decoder takes up to 5 s."""
_PLAIN = (b"P1", b"P2", b"P3")
_MAGIC = (*_PLAIN, b"P4", b"P5", b"P6", b"\x89PNG")
"""What images of the formats begin with."""
_FORMATS = "a PGM, PPM, PBM or PNG file"
_OCCUPIED_THRESHOLD, _FREE_THRESHOLD = "0.65", "0.25"
"""Thresholds that map_saver writes, where a file has none."""
_MODES = ("trinary", "scale", "raw")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)
_INTEGER = re.compile(r"[-+]?\d+", re.ASCII)
_TRUTH = {
    **dict.fromkeys(("true", "yes", "on", "y"), True),
    **dict.fromkeys(("false", "no", "off", "n"), False),
}
_LUMA = (0.299, 0.587, 0.114, 0.0015 - 0.5)
"""Grey of a colour (ITU-R BT.601), rounded down as GraphicsMagick does, which map_server uses: it
computes with 16 bits, where only 0.999 of a level becomes a whole one. Pillow adds 0.5."""

_Entry = str | list[str] | dict[str, str] | None


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
    """Read a map file by the rules of map_server of ROS 2 Jazzy; see docs/floor.md.

    Parameters
    ----------
    path : Path
        YAML file, looked for by `find_file`, with image (relative to it), resolution [m], origin
        (x, y [m], yaw [rad]), mode, negate, occupied_thresh and free_thresh.

    Raises
    ------
    InvalidMapError
        If a file cannot be read, or an entry is missing or not what it has to be.
    """
    name = f"map file {path}"
    try:
        return _read(name, find_file(path))
    except InvalidMapError:
        raise
    except InvalidFileError as error:
        raise InvalidMapError(name, str(error.given), error.expected) from None
    except Exception as error:  # parsers and decoders raise many kinds for a broken file
        raise InvalidMapError(name, shown(error), "a YAML file of map_server") from None


def _read(name: str, path: Path) -> MapValues:
    entries = _entries(name, read_file(path, _MAX_TEXT_BYTES))
    given = entries.get("mode", "trinary")
    mode = given.lower() if isinstance(given, str) else ""
    if mode not in _MODES:
        raise InvalidMapError(name, _written("mode", given), "trinary, scale or raw")
    resolution = _number(name, "resolution", entries.get("resolution"))
    origin = _origin(name, entries.get("origin"))
    is_negated = _truth(name, "negate", entries.get("negate", "0"))
    occupied, free = (
        _number(name, key, entries.get(key, default))
        for key, default in (
            ("occupied_thresh", _OCCUPIED_THRESHOLD), ("free_thresh", _FREE_THRESHOLD)
        )
    )
    if not 0.0 <= free <= occupied <= 1.0:
        raise InvalidMapError(
            name, f"free_thresh {free:g} and occupied_thresh {occupied:g}",
            "0 <= free_thresh <= occupied_thresh <= 1",
        )
    image = entries.get("image")
    if not isinstance(image, str) or not image:
        raise InvalidMapError(name, _written("image", image), f"the name of {_FORMATS}")
    place = (*origin[:2], 0.0, 0.0, 0.0, math.sin(0.5 * origin[2]), math.cos(0.5 * origin[2]))

    def check(width: int, height: int) -> None:
        check_geometry(name, width, height, resolution, place)

    pixels, transparent = _pixels(name, path.parent / image, check)
    values = np.take(_values_of_greys(mode, is_negated, occupied, free), pixels)
    if transparent is not None and mode != "raw":
        values[transparent] = -1
    return MapValues(values[::-1], resolution, origin)  # in images row 0 is at the top


def _values_of_greys(
    mode: str, is_negated: bool, occupied: float, free: float
) -> NDArray[np.int8]:
    """Return the value of a cell for each grey, shape (256,), computed in single precision."""
    greys = np.arange(256)
    if mode == "raw":
        return np.where(greys <= 100, greys, -1).astype(np.int8)
    shares = greys.astype(np.float32) / np.float32(255.0)
    shares = shares if is_negated else np.float32(1.0) - shares
    upper, lower = np.float32(occupied), np.float32(free)
    values = np.full(256, -1, dtype=np.int8)
    values[shares >= upper] = 100
    if mode == "scale":
        between = (shares > lower) & (shares < upper)
        scaled = (shares[between] - lower) / np.float32(occupied - free) * np.float32(100.0)
        values[between] = np.floor(scaled.astype(np.float64) + 0.5)
    values[shares <= lower] = 0
    return values


def _pixels(
    name: str, image: Path, check: Callable[[int, int], None]
) -> tuple[NDArray[np.integer], NDArray[np.bool_] | None]:
    """Return the greys of an image's pixels, 0 to 255, shape (H, W), and which are transparent.

    `check` takes the numbers of columns and rows, and raises an error for those that are refused.
    """
    from PIL import Image

    # Larger images than the limit of Pillow are refused by their size.
    Image.MAX_IMAGE_PIXELS, limit = None, Image.MAX_IMAGE_PIXELS
    try:
        content = read_file(image, _MOST_IMAGE)
        if not content.startswith(_MAGIC):
            raise InvalidMapError(name, f"image {image}: {shown(content[:8])}", _FORMATS)
        if content.startswith(_PLAIN) and len(content) > _MAX_PLAIN_BYTES:
            raise InvalidMapError(
                name, f"an image of {len(content)} bytes in decimal numbers",
                f"at most {_MAX_PLAIN_BYTES}; a binary one (P5) is smaller",
            )
        with Image.open(io.BytesIO(content), formats=("PPM", "PNG")) as opened:
            check(*opened.size)
            if opened.mode.startswith("I"):  # 16 bits
                deep = np.asarray(opened)
                hidden = opened.info.get("transparency")
                return deep // 257, None if hidden is None else deep == hidden
            found: Image.Image = opened
            transparent = None
            if "A" in opened.getbands() or "transparency" in opened.info:
                found = opened.convert("RGBA")
                transparent = np.asarray(found.getchannel("A")) < 255
            is_grey = opened.mode in ("1", "L")
            grey = opened.convert("L") if is_grey else found.convert("RGB").convert("L", _LUMA)
            return np.asarray(grey), transparent
    except InvalidMapError:
        raise
    except InvalidFileError as error:
        raise InvalidMapError(name, f"image {image}: {error.given}", error.expected) from None
    except Exception as error:
        raise InvalidMapError(name, f"image {image}: {shown(error)}", _FORMATS) from None
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _entries(name: str, text: bytes) -> dict[str, _Entry]:
    """Return the entries as texts, whose types are not those of YAML but what each has to be."""
    found = yaml_texts(text, _MAX_DEPTH)
    if not isinstance(found, dict) or not found:
        raise InvalidMapError(name, shown(text), "a mapping with image, resolution ...")
    return found


def _number(name: str, key: str, given: _Entry) -> float:
    value = math.nan
    if isinstance(given, str) and _NUMBER.fullmatch(given):
        value = float(given)
    if not math.isfinite(value):
        raise InvalidMapError(name, _written(key, given), "a finite number")
    return value


def _truth(name: str, key: str, given: _Entry) -> bool:
    text = given.lower() if isinstance(given, str) else ""
    if _INTEGER.fullmatch(text):
        return int(text) != 0
    if text not in _TRUTH:
        raise InvalidMapError(name, _written(key, given), "0 or 1, true or false")
    return _TRUTH[text]


def _origin(name: str, given: _Entry) -> tuple[float, float, float]:
    if not isinstance(given, list) or len(given) != 3:
        raise InvalidMapError(name, _written("origin", given), "[x, y, yaw]")
    x, y, yaw = (_number(name, "origin", value) for value in given)
    return x, y, yaw


def _written(key: str, given: _Entry) -> str:
    if given is None:
        return f"no {key}"
    if isinstance(given, str):
        return f"{key} {given}"
    return f"{key} {'a mapping' if isinstance(given, dict) else given}".replace("'", "")
