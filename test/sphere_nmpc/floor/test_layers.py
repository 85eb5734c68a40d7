# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Map, edge and areas to keep out of, put together, and the settings that they come from."""

import json
from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError
from sphere_nmpc.floor.settings import FloorSettings

RADIUS = 0.3
HALL = Grid(np.zeros((4, 8), dtype=bool), 0.5)
"""Free map of 4 m x 2 m."""
ROOM = np.array([[0.5, 0.5], [3.0, 0.5], [3.0, 1.5], [0.5, 1.5]])
PILLAR = np.array([[1.5, 0.8], [1.7, 0.8], [1.7, 1.0], [1.5, 1.0]])


def clear(grid: Grid | None, x: float, y: float) -> float:
    """Return the distance of a place from what is occupied [m]."""
    assert grid is not None
    return float(Floor(grid, RADIUS, 0.0).distances(np.array([[x, y]]))[0])


def test_nothing_given_is_no_floor() -> None:
    assert Layers().grid(RADIUS) is None
    assert Layers().with_keepout(3, None).grid(RADIUS) is None


def test_map_alone_stays_as_it_is() -> None:
    assert Layers(HALL).grid(RADIUS) is HALL


def test_edge_alone_encloses_the_floor() -> None:
    grid = Layers(edge=ROOM).grid(RADIUS)
    assert clear(grid, 1.0, 1.0) == pytest.approx(0.5, abs=0.04)
    assert clear(grid, 0.4, 1.0) == 0.0 and clear(grid, 10.0, 1.0) == 0.0


def test_area_alone_lies_on_free_floor_that_includes_the_origin() -> None:
    grid = Layers(keepouts={1: PILLAR + 40.0}).grid(RADIUS)
    assert clear(grid, 0.0, 0.0) > 20.0 and clear(grid, 41.6, 40.9) == 0.0
    assert grid is not None and grid.occupied.size < 5_000_000


def test_layers_are_put_together() -> None:
    grid = Layers(HALL, ROOM, {4: PILLAR}).grid(RADIUS)
    assert grid is not None
    assert grid.resolution == pytest.approx(RADIUS / 24.0), "finer than the map"
    assert clear(grid, 2.5, 1.0) == pytest.approx(0.5, abs=0.04)
    assert clear(grid, 1.6, 0.9) == 0.0
    assert clear(grid, 3.5, 1.0) == 0.0, "on the map, but outside of the edge"
    assert clear(grid, 1.4, 0.9) == pytest.approx(0.1, abs=0.04)


def test_area_is_replaced_and_removed_by_its_id() -> None:
    first = Layers(HALL).with_keepout(1, PILLAR)
    both = first.with_keepout(2, PILLAR + 1.0)
    moved = both.with_keepout(1, PILLAR + 0.5)
    assert sorted(moved.keepouts) == [1, 2] and moved.keepouts[1] is not PILLAR
    assert clear(moved.grid(RADIUS), 1.6, 0.9) > 0.0
    assert sorted(first.keepouts) == [1], "layers do not change"
    assert sorted(moved.with_keepout(1, None).keepouts) == [2]


def map_file(folder: Path) -> Path:
    """Write a map of two cells, of which the first is free and the second is grey."""
    (folder / "hall.pgm").write_bytes(b"P5 2 1 255\n\xff\x80")
    file = folder / "hall.yaml"
    file.write_text("image: hall.pgm\nresolution: 2\norigin: [0, 0, 0]\n")
    return file


def test_settings_make_the_whole_floor(tmp_path) -> None:
    assert FloorSettings().whole(RADIUS) is None
    settings = FloorSettings(map_file=str(map_file(tmp_path)), clearance=0.1)
    floor = settings.whole(RADIUS)
    assert floor is not None and floor.needed == pytest.approx(0.4)
    assert floor.grid.occupied.tolist() == [[False, True]]
    known = FloorSettings(map_file=settings.map_file, unknown_is_free=True).whole(RADIUS)
    assert known is not None and not known.grid.occupied.any()
    room = FloorSettings(floor=json.dumps(ROOM.tolist())).whole(RADIUS)
    assert room is not None and room.clearance == 0.03
    np.testing.assert_array_equal(FloorSettings(floor=json.dumps(ROOM.tolist())).edge(), ROOM)
    assert FloorSettings(floor="  ").edge() is None


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"floor": "[[0, 0], [1, 1]"}, "floor: given '[[0, 0], [1, 1]', expected corners such as"),
        ({"floor": "[[0, 0, 0], [1, 1, 1]]"}, "floor: given "),
        ({"floor": "7"}, "floor: given '7', expected corners such as"),
        ({"floor": "[[0, 0], [1, 0], [1, NaN]]"}, "floor: given '3 corners', expected three or"),
        ({"floor": "[[0, 0], [1, 1], [1, 0], [0, 1]]"}, "floor: given 'edges 0 and 2 that cross'"),
        ({"clearance": -0.1}, "clearance: given -0.1, expected 0 to 100 [m]"),
        ({"clearance": float("nan")}, "clearance: given nan, expected a finite number"),
        ({"occupied_threshold": 0.0}, "occupied_threshold: given 0.0, expected 0.01 to 1"),
        ({"unknown_is_free": 1}, "unknown_is_free: given 1, expected true or false"),
    ],
)
def test_wrong_setting_is_named(settings, told) -> None:
    with pytest.raises(InvalidParameterError) as caught:
        FloorSettings(**settings)
    assert told in str(caught.value)


def test_map_file_that_cannot_be_read_is_named(tmp_path) -> None:
    settings = FloorSettings(map_file=str(tmp_path / "none.yaml"))
    with pytest.raises(InvalidMapError, match=r"map file .*none\.yaml"):
        settings.whole(RADIUS)
