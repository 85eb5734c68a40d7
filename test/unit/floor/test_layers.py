# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Map, edge and areas to keep out of, put together, and the settings that they come from."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError, touched_runs
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


def test_nothing_given_is_no_floor_and_a_map_alone_stays_as_it_is() -> None:
    assert Layers().with_keepout(3, None).grid(RADIUS) is None
    assert Layers(HALL).grid(RADIUS) is HALL


@pytest.mark.parametrize(
    ("layers", "distances"),
    [
        (Layers(edge=ROOM), {(1.0, 1.0): 0.5, (0.4, 1.0): 0.0, (10.0, 1.0): 0.0}),
        (Layers(keepouts={1: PILLAR + 40.0}), {(41.6, 40.9): 0.0, (41.1, 40.9): 0.4}),
        # The last place is on the map, but outside of the edge.
        (Layers(HALL, ROOM, {4: PILLAR}),
         {(2.5, 1.0): 0.5, (1.6, 0.9): 0.0, (1.4, 0.9): 0.1, (3.5, 1.0): 0.0}),
    ],
    ids=["edge", "area", "all"],
)
def test_layers_are_put_together(layers, distances) -> None:
    grid = layers.grid(RADIUS)
    assert grid is not None and grid.occupied.size < 5_000_000
    # A cell as fine as a sphere needs, finer than the map's.
    assert grid.resolution == pytest.approx(RADIUS / 24.0) or layers.map is None
    for place, expected in distances.items():
        found = clear(grid, *place)
        assert found == pytest.approx(expected, abs=0.04) and (found == 0.0) == (expected == 0.0)
    assert layers.edge is not None or clear(grid, 0.0, 0.0) > 20.0, "free floor at the origin"


def test_area_is_replaced_and_removed_by_its_id() -> None:
    first = Layers(HALL).with_keepout(1, PILLAR)
    moved = first.with_keepout(2, PILLAR + 1.0).with_keepout(1, PILLAR + 0.5)
    assert sorted(first.keepouts) == [1] and sorted(moved.keepouts) == [1, 2]
    assert clear(moved.grid(RADIUS), 1.6, 0.9) > 0.0
    assert sorted(moved.with_keepout(1, None).keepouts) == [2]
    far = Layers(HALL, ROOM, {1: PILLAR + 1e5}).grid(RADIUS)
    np.testing.assert_array_equal(far.occupied, Layers(HALL, ROOM).grid(RADIUS).occupied)


@pytest.mark.parametrize(
    ("layers", "told"),
    [
        (Layers(keepouts={4: PILLAR, 7: PILLAR + 1e5}),
         "keepout 7: given a floor of 1.001e+05 m x 1.001e+05 m, expected at most 2.25e+0"),
        (Layers(edge=200.0 * ROOM), "floor: given a floor of 500 m x 200 m, expected at most"),
        (Layers(edge=ROOM * (3e5, 1e-6)), "floor: given a floor of 7.5e+05 m x 1e-06 m, exp"),
        (Layers(edge=ROOM + np.array((999_998.0, 0.0))),
         "floor: given a corner at 1000001 m, expected all within 1e+06 m"),
    ],
)
def test_layer_that_would_make_cells_too_large_is_refused(layers, told) -> None:
    with pytest.raises(InvalidMapError) as caught:
        layers.grid(RADIUS)
    assert str(caught.value).startswith(told)


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_extent_of_a_floor_without_a_map_grows_with_the_sphere(scale) -> None:
    radius = scale * RADIUS
    grid = Layers(keepouts={1: scale * PILLAR}).grid(radius)
    finest = Layers(keepouts={1: PILLAR}).grid(RADIUS).resolution
    assert grid.resolution == pytest.approx(scale * finest) and grid.resolution < 0.15 * radius
    for place in ((25.0, 0.0), (-25.0, 0.0), (0.0, 25.0), (0.0, -25.0)):
        assert grid.contains(scale * np.array(place))


def test_number_of_areas_is_limited() -> None:
    layers = Layers(HALL)
    for number in range(1000):
        layers = layers.with_keepout(number, PILLAR)
    with pytest.raises(InvalidMapError, match="keepout 1000: given 1001 areas, expected at "):
        layers.with_keepout(1000, PILLAR)
    assert len(layers.with_keepout(7, ROOM).keepouts) == 1000, "another polygon of the same"
    assert len(layers.with_keepout(7, None).with_keepout(1000, PILLAR).keepouts) == 1000


def test_cells_are_computed_again_only_for_what_has_changed(monkeypatch) -> None:
    entered: list[float] = []
    monkeypatch.setattr(
        "sphere_nmpc.floor.layers.touched_runs",
        lambda grid, polygon: entered.append(float(polygon[0, 0])) or touched_runs(grid, polygon),
    )
    layers = Layers(keepouts={number: PILLAR + 0.01 * number for number in range(50)})
    first = layers.grid(RADIUS)
    moved = layers.with_keepout(7, PILLAR + 1.0)
    grid = moved.grid(RADIUS)
    assert entered[50:] == [2.5], "on a floor of the same extent"
    assert moved.with_keepout(8, None).grid(RADIUS).occupied.any() and len(entered) == 51
    fresh = Layers(keepouts=moved.keepouts).grid(RADIUS)
    assert grid.origin == fresh.origin == first.origin
    walled, right = replace(moved, map=HALL), Layers(HALL, None, moved.keepouts)
    for found, expected in ((grid, fresh), (walled.grid(RADIUS), right.grid(RADIUS)),
                            (moved.grid(RADIUS), fresh)):
        np.testing.assert_array_equal(found.occupied, expected.occupied)


def test_settings_make_the_whole_floor(tmp_path) -> None:
    with pytest.raises(InvalidParameterError, match=r"^clearance: given -0\.1, expected 0 to 100"):
        FloorSettings(clearance=-0.1)
    assert FloorSettings().whole(RADIUS).is_empty and FloorSettings(floor="  ").edge() is None
    file = tmp_path / "hall.yaml"
    with pytest.raises(InvalidMapError, match=r"map file .*hall\.yaml"):
        FloorSettings(map_file=str(file)).whole(RADIUS)
    # Two cells, of which the first is free and the second is grey.
    (tmp_path / "hall.pgm").write_bytes(b"P5 2 1 255\n\xff\x80")
    file.write_text("image: hall.pgm\nresolution: 2\norigin: [0, 0, 0]\n")
    floor = FloorSettings(map_file=str(file), clearance=0.1).whole(RADIUS)
    assert floor.needed == pytest.approx(0.4) and floor.grid.occupied.tolist() == [[False, True]]
    known = FloorSettings(map_file=str(file), unknown_is_free=True).whole(RADIUS)
    assert not known.grid.occupied.any()
    room = FloorSettings(floor=json.dumps(ROOM.tolist()))
    np.testing.assert_array_equal(room.edge(), ROOM)
    assert room.whole(RADIUS).clearance == 0.03


@pytest.mark.parametrize(
    ("edge", "told"),
    [
        ("[[0, 0], [1, 1]", "given '[[0, 0], [1, 1]', expected corners such as"),
        ("[[0, 0, 0], [1, 1, 1]]", "given "),
        ("7", "given '7', expected corners such as"),
        ("[" * 100_000, "given '[[[[["),
        (f"[[0, 0], [1, 0], [1, 1{'0' * 400}]]", "given '[[0, 0], [1, 0], ["),
        ("[" + "[0, 0], " * 50_000 + "]", "expected at most 320000 characters"),
        ("[[0, 0], [1, 0], [1, NaN]]", "given 3 corners, expected three or"),
        ("[[0, 0], [1, 1], [1, 0], [0, 1]]", "given edges 0 and 2 that cross"),
    ],
    ids=range(8),
)
def test_wrong_edge_is_named(edge, told) -> None:
    with pytest.raises(InvalidParameterError, match=r"^floor: ") as caught:
        FloorSettings(floor=edge)
    assert told in str(caught.value)
