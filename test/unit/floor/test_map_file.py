# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Map files as map_server writes them, and those that cannot be used."""

import math
import os
import re
from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.floor.map_file import MapValues, read_map
from sphere_nmpc.floor.occupancy import InvalidMapError

LEVELS = np.array([[0, 254, 205], [254, 254, 0]], dtype=np.uint8)
"""Brightness of two rows, the upper one first: black, white and the grey of unknown cells."""
VALUES = [[0, 0, 100], [100, 0, -1]]
"""The same as values of a map, the lower row first."""


def written(folder: Path, data: bytes | None = None, **entries: object) -> Path:
    """Write a map file and its PGM; entries that are None are left out."""
    name = "hall.pgm"
    own = b"P5\n# a comment\n3 2\n255\n" + LEVELS.tobytes()
    (folder / name).write_bytes(own if data is None else data)
    given = {
        "image": name, "resolution": 0.05, "origin": [-1.0, 2.0, 0.0], "negate": 0,
        "occupied_thresh": 0.65, "free_thresh": 0.196, **entries,
    }
    file = folder / "hall.yaml"
    file.write_text("".join(f"{k}: {v}\n" for k, v in given.items() if v is not None))
    return file


def plain(maximum: int = 255) -> bytes:
    """Return the image as a PGM in decimal numbers."""
    numbers = " ".join(str(round(int(level) * maximum / 255)) for level in LEVELS.ravel())
    return f"P2\n3 2\n{maximum}\n{numbers}\n".encode()


@pytest.mark.parametrize("image", [None, plain(), plain(65535)], ids=["P5", "P2", "16 bits"])
def test_pgm_is_read_with_its_lowest_row_first(tmp_path, image) -> None:
    found = read_map(written(tmp_path, image))
    assert found.values.dtype == np.int8 and found.values.tolist() == VALUES
    assert found.resolution == 0.05 and found.origin == (-1.0, 2.0, 0.0)


def test_png_is_read_in_grey_and_in_colour(tmp_path) -> None:
    pillow = pytest.importorskip("PIL.Image")
    for mode in ("L", "RGB"):
        pillow.fromarray(LEVELS).convert(mode).save(tmp_path / "hall.png")
        assert read_map(written(tmp_path, image="hall.png")).values.tolist() == VALUES


def test_negated_image_has_white_as_occupied(tmp_path) -> None:
    found = read_map(written(tmp_path, negate=1))
    # The grey is 80 per cent then.
    assert found.values.tolist() == [[100, 100, 0], [0, 100, 100]]
    assert read_map(written(tmp_path, negate="true")).values.tolist() == found.values.tolist()


@pytest.mark.parametrize(
    ("occupied", "free", "grey"), [(0.19, 0.1, 100), (0.65, 0.2, 0), (0.2, 0.19, -1)]
)
def test_thresholds_decide_on_grey(tmp_path, occupied, free, grey) -> None:
    found = read_map(written(tmp_path, occupied_thresh=occupied, free_thresh=free))
    assert found.values[1, 2] == grey and found.values[0].tolist() == VALUES[0]


def test_entries_that_may_be_missing_are_those_of_map_server(tmp_path) -> None:
    found = read_map(written(tmp_path, negate=None, occupied_thresh=None, free_thresh=None))
    # The grey is 19.6 per cent, free below 25.
    assert found.values.tolist() == [[0, 0, 100], [100, 0, 0]]


def test_grid_of_a_map_is_turned_with_its_origin(tmp_path) -> None:
    found = read_map(written(tmp_path, origin=[1.0, 2.0, 0.5 * math.pi]))
    assert found.values.tolist() == VALUES
    grid = found.grid(0.65, unknown_is_free=False)
    assert grid.origin == pytest.approx((1.0, 2.0, 0.5 * math.pi))
    # Third cell of the first row: along the grid's x axis, which is the world's y axis.
    np.testing.assert_allclose(grid.local(np.array([1.0 - 0.025, 2.0 + 0.125])), [2.5, 0.5])
    assert grid.occupied.tolist() == [[False, False, True], [True, False, True]]
    assert not found.grid(0.65, unknown_is_free=True).occupied[1, 2]


def test_values_become_occupied_from_the_threshold_on() -> None:
    values = MapValues(np.array([[0, 49, 50, 100, -1]], dtype=np.int8), 0.1, (0.0, 0.0, 0.0))
    assert values.grid(0.5, False).occupied.tolist() == [[False, False, True, True, True]]
    assert values.grid(0.5, True).occupied.tolist() == [[False, False, True, True, False]]


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ({"resolution": None}, "given 'no resolution', expected a finite number"),
        ({"resolution": 0.0}, "given 'a resolution of 0 m', expected a positive number"),
        ({"resolution": "fine"}, "given 'resolution fine', expected a finite number"),
        ({"resolution": ".nan"}, "given 'resolution .nan', expected a finite number"),
        ({"origin": None}, "given 'no origin', expected [x, y, yaw]"),
        ({"origin": [0, 0]}, "given 'origin [0, 0]', expected [x, y, yaw]"),
        ({"origin": "[0, 0, .inf]"}, "given 'origin .inf', expected a finite number"),
        ({"mode": "cost"}, "given 'mode cost', expected trinary, scale or raw"),
        ({"free_thresh": 0.7}, "given 'free_thresh 0.7 and occupied_thresh 0.65', expected 0 <="),
        ({"image": None}, "given 'no image', expected the name of a PGM, PPM, PBM or PNG"),
        ({"image": "none.pgm"}, "expected a PGM, PPM, PBM or PNG file"),
        ({"image": "hall.yaml"}, "expected a PGM, PPM, PBM or PNG file"),
    ],
)
def test_wrong_entry_is_named(tmp_path, entries, told) -> None:
    with pytest.raises(InvalidMapError) as caught:
        read_map(written(tmp_path, **entries))
    assert told in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "", "image: [", "- image", "\x00", "a: !!python/object:x {}", "[" * 10_000,
        f"resolution: 1{'0' * 400}\norigin: [0, 0, 0]\nimage: x", "#" * 20_000,
        "a: &a [1, 1]\nb: &b [*a, *a]\nmode: [*b, *b]\n",
    ],
    ids=range(9),
)
def test_file_that_is_no_map_is_named(tmp_path, text) -> None:
    file = tmp_path / "hall.yaml"
    file.write_text(text)
    for wrong in (file, tmp_path, tmp_path / "none.yaml"):
        with pytest.raises(InvalidMapError, match=r"^map file ") as caught:
            read_map(wrong)
        assert wrong.name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "image", [b"P5 3 2 255\n\x00\x00", b"P5 -3 2 255\n", b"P2 3 2 255\n1 2 x 4 5 6", b""]
)
def test_broken_image_is_refused(tmp_path, image) -> None:
    with pytest.raises(InvalidMapError, match=r"image .*hall\.pgm"):
        read_map(written(tmp_path, image))


def test_image_with_too_many_cells_is_refused_before_it_is_read(tmp_path) -> None:
    with pytest.raises(InvalidMapError, match="20000 x 20000 cells"):
        read_map(written(tmp_path, b"P5 20000 20000 255\n"))


def test_map_of_another_kind_of_file_is_refused_at_once(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for wrong, kind in (("/dev/zero", "a device"), (str(tmp_path / "pipe"), "a pipe")):
        with pytest.raises(InvalidMapError, match=f"^map file {wrong}: given '{kind}', expected"):
            read_map(Path(wrong))
        with pytest.raises(InvalidMapError, match=f"given 'image {wrong}: {kind}', expected a re"):
            read_map(written(tmp_path, image=wrong))


def test_image_in_another_format_is_refused(tmp_path) -> None:
    pillow = pytest.importorskip("PIL.Image")
    for name in ("hall.gif", "hall.jpg", "hall.tif", "hall.bmp"):
        pillow.fromarray(LEVELS).convert("RGB").save(tmp_path / name)
        with pytest.raises(InvalidMapError, match="expected a PGM, PPM, PBM or PNG file"):
            read_map(written(tmp_path, image=name))


def test_image_that_takes_long_to_be_read_is_refused(tmp_path) -> None:
    image = b"P2 4000 4000 255\n" + b"0 " * 16_000_000
    with pytest.raises(InvalidMapError, match="32000017 bytes in decimal numbers', expected at m"):
        read_map(written(tmp_path, image))


def test_map_that_no_node_could_use_is_refused(tmp_path) -> None:
    for entries, told in (
        ({"resolution": "1.0e-30"}, "given 'a resolution of 1e-30 m', expected a positive"),
        ({"origin": [2e6, 0, 0]}, "given 'a corner at 2000000 m', expected all within 1e"),
    ):
        with pytest.raises(InvalidMapError, match=f"map file .*: {re.escape(told)}"):
            read_map(written(tmp_path, **entries))
