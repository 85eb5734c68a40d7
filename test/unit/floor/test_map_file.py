# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Map files, by each row of the table in docs/floor.md: what map_server does, and read_map."""

import io
import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.floor.map_file import MapValues, read_map
from sphere_nmpc.floor.occupancy import InvalidMapError

GREYS = [[0, 90, 205], [254, 165, 255]]
VALUES = [[0, -1, 0], [100, -1, -1]]
"""Of the lower row first; shares are 1, 0.6471 and 0.1961, and 0.0039, 0.3529 and 0."""
ENTRIES = {
    "image": "hall.png", "resolution": "0.05", "origin": "[-1.0, 2.0, 0.5]", "negate": "0",
    "occupied_thresh": "0.65", "free_thresh": "0.196",
}
DOCUMENT = Path(__file__).parents[3] / "docs" / "floor.md"


def png(pixels: object, mode: str = "L", kind: str = "PNG", **options: object) -> bytes:
    """Return an image file of Pillow's mode."""
    from PIL import Image

    file = io.BytesIO()
    image = Image.fromarray(np.array(pixels, np.uint16 if mode == "I;16" else np.uint8))
    if mode == "P":
        image.putpalette([0, 0, 0, 90, 90, 90, 205, 205, 205, 254, 254, 254, 1, 2, 2])
    elif mode == "1":
        image = image.convert("1")
    image.save(file, kind, **options)
    return file.getvalue()


def read(folder: Path, **given: object) -> MapValues:
    """Read a map with other entries; an image as bytes is written, None leaves an entry out."""
    image = given.pop("image") if isinstance(given.get("image"), bytes) else png(GREYS)
    edited = given.pop("text", str)
    (folder / "hall.png").write_bytes(image)
    entries = {**ENTRIES, **given}
    lines = "".join(f"{key}: {value}\n" for key, value in entries.items() if value is not None)
    (folder / "hall.yaml").write_text(edited(lines))
    return read_map(folder / "hall.yaml")


def named(rows: Sequence[tuple]) -> list[str]:
    return [f"{row[0]} {number}" for number, row in enumerate(rows)]


BLACK_AND_WHITE = [[0, 255, 255], [255, 255, 0]]
WALLS = [[0, 0, 100], [100, 0, 0]]
COLOURS = [[(0, 0, 100), (100, 0, 0), (0, 100, 0)], [(1, 2, 2), (3, 3, 4), (10, 20, 30)]]
OF_COLOURS = [[1, 3, 18], [11, 29, 58]]
"""Of 1000 parts 299 red, 587 green, 114 blue, rounded down: 1.7, 3.1, 18.2, 11.4, 29.9, 58.7."""
PALETTE = [[0, 1, 2], [3, 3, 4]]
DEEP = [[0, 128, 256], [257, 385, 100 * 257 + 256]]
OF_DEEP = [[1, 1, 100], [0, 0, 0]]
"""A 257th part, rounded down."""
WITH_ALPHA = [[(grey, 255) for grey in row] for row in GREYS]
WITH_ALPHA[0][0], WITH_ALPHA[1][2] = (0, 254), (255, 0)

SAME: list[tuple[str, dict[str, object], list[list[int]]]] = [
    ("occupied from", {"occupied_thresh": 1, "free_thresh": 0}, [[-1, -1, 0], [100, -1, -1]]),
    ("occupied from", {"occupied_thresh": 1 - 90 / 255}, [[0, -1, 0], [100, 100, -1]]),
    ("free up to", {"free_thresh": 1 - 205 / 255}, [[0, -1, 0], [100, -1, 0]]),
    ("free up to", {"free_thresh": "0.19607842"}, [[0, -1, 0], [100, -1, 0]]),
    ("free before occupied", {"occupied_thresh": "0.647058824", "free_thresh": "0.647058824"},
     [[0, 0, 0], [100, 0, 0]]),
    ("`mode` is missing", {}, VALUES),
    *(("upper or lower case", {"mode": mode}, VALUES)
      for mode in ("Trinary", "TRINARY", "'trinary'")),
    ("`scale`", {"mode": "scale"}, [[0, 35, 0], [100, 99, 0]]),
    ("`scale`", {"mode": "Scale", "negate": 1, "occupied_thresh": 1, "free_thresh": 0},
     [[100, 65, 100], [0, 35, 80]]),
    ("`raw`", {"mode": "RAW", "negate": 1}, [[-1, -1, -1], [0, 90, -1]]),
    *(("`negate`", {"negate": text}, [[100, -1, 100], [0, -1, 100]])
      for text in ("1", "2", "-1", "010", "'1'", "true", "True", "YES", "on", "y")),
    *(("`negate`", {"negate": text}, VALUES)
      for text in ("0", "00", "false", "no", "Off", "n")),
    *(("numbers", {"resolution": text}, VALUES)
      for text in ("5e-2", "'0.05'", ".5E-1", "+0.05", "5.e-2", "!!str 0.05")),
    ("numbers", {"origin": "['-1', 2., 5e-1]"}, VALUES),
    ("unknown entries", {"kind": "hall", "sizes": "[1, 2]"}, VALUES),
    ("two entries of one name", {"text": lambda lines: lines + "resolution: 7\n"}, VALUES),
    ("byte order mark", {"text": lambda lines: "\ufeff" + lines}, VALUES),
    ("CRLF", {"text": lambda lines: lines.replace("\n", "\r\n")}, VALUES),
    ("several documents", {"text": lambda lines: lines + "---\n- other\n"}, VALUES),
    ("JSON", {"text": lambda lines: "{" + lines.replace("\n", ", ") + "}"}, VALUES),
    ("transparent", {"image": png(WITH_ALPHA)}, [[0, -1, -1], [-1, -1, -1]]),
    ("transparent", {"image": png(WITH_ALPHA), "mode": "scale"}, [[0, 35, -1], [-1, 99, 0]]),
    ("transparent", {"image": png(WITH_ALPHA), "mode": "raw"}, [[-1, -1, -1], [0, 90, -1]]),
    ("transparent", {"image": png([[(g, g, g, a) for g, a in row] for row in WITH_ALPHA])},
     [[0, -1, -1], [-1, -1, -1]]),
    ("transparent", {"image": png(PALETTE, "P", transparency=bytes([254, 255, 255, 255, 255]))},
     [[0, 0, 100], [-1, -1, -1]]),
    ("transparent", {"image": png(BLACK_AND_WHITE, "1", transparency=0)},
     [[0, 0, -1], [-1, 0, 0]]),
    ("transparent", {"image": png(GREYS, transparency=0)}, [[0, -1, 0], [-1, -1, -1]]),
    ("colours", {"image": png(COLOURS), "mode": "raw"}, OF_COLOURS),
    ("palette", {"image": png(PALETTE, "P"), "mode": "raw"}, [[-1, -1, 1], [0, 90, -1]]),
    ("1 bit", {"image": png(BLACK_AND_WHITE, "1")}, WALLS),
    ("16 bits", {"image": png(DEEP, "I;16"), "mode": "raw"}, OF_DEEP),
    ("16 bits", {"image": b"P5 3 2 65535\n" + np.array(DEEP, ">u2").tobytes(), "mode": "raw"},
     OF_DEEP),
    *(("PGM", {"image": image, "mode": "raw"}, [[50, 99, 100], [0, 1, 49]])
      for image in (
          b"P5\n# a\n3 2\n# b\n255\n" + bytes([0, 1, 49, 50, 99, 100]),
          b"P5 3 2 255\n" + bytes([0, 1, 49, 50, 99, 100]) + b"P5 1 1 255\n\x00",
          b"P2\n#a\n3 2 # b\n255\n0 1 49\n# c\n50 99 100\n",
      )),
    ("PGM", {"image": b"P2 3 2 5\n0 1 2 0 1 2\n", "mode": "raw"}, [[0, 51, -1], [0, 51, -1]]),
    ("PPM and PBM", {"image": b"P6 3 2 255\n" + np.array(COLOURS, np.uint8).tobytes(),
                     "mode": "raw"}, OF_COLOURS),
    ("PPM and PBM", {"image": b"P3 3 2 255\n0 0 100 100 0 0 0 100 0 1 2 2 3 3 4 10 20 30\n",
                     "mode": "raw"}, OF_COLOURS),
    ("PPM and PBM", {"image": b"P1 3 2\n1 0 0\n0 0 1\n"}, WALLS),
    ("PPM and PBM", {"image": b"P4 3 2\n\x80\x20"}, WALLS),
    # Refused by map_server.
    ("no `negate`", {"negate": None}, VALUES),
    ("no `negate`", {"occupied_thresh": None}, VALUES),
    ("no `negate`", {"free_thresh": None}, [[0, -1, 0], [100, -1, 0]]),
    ("file names end", {"image": b"P5 3 2 255\n" + bytes(GREYS[0] + GREYS[1])}, VALUES),
]


@pytest.mark.parametrize(("row", "given", "expected"), SAME, ids=named(SAME))
def test_values_are_those_of_map_server(tmp_path, row, given, expected) -> None:
    found = read(tmp_path, **given)
    assert found.values.dtype == np.int8 and found.values.tolist() == expected
    assert (found.resolution, found.origin) == (0.05, (-1.0, 2.0, 0.5))


REFUSED: list[tuple[str, dict[str, object], str]] = [
    ("no `image`", {"image": None}, "no image, expected the name of a PGM, PPM, PBM or PNG"),
    ("no `image`", {"resolution": None}, "no resolution, expected a finite number"),
    ("no `image`", {"origin": None}, "no origin, expected [x, y, yaw]"),
    *(("`mode` of another name", {"mode": mode}, f"mode {mode}, expected trinary, scale or raw")
      for mode in ("cost", "")),
    *(("`negate`", {"negate": text}, "negate ")
      for text in ("0.0", "maybe", "", "~", "1_0", "[1]", "0x1")),
    *(("numbers", {"resolution": text}, f"resolution {text}, expected a finite number")
      for text in ("0.0_5", "1:30", "0x1", "0.05 m", "1d-2", "1e400", "")),
    *(("`origin`", {"origin": text}, "origin ")
      for text in ("[0, 0]", "[0, 0, 0, 0]", "0 0 0", "[0, 0, x]", "{x: 1}")),
    *(("not finite", given, "expected a finite number") for given in
      ({"resolution": ".inf"}, {"origin": "[0, 0, .nan]"}, {"free_thresh": ".nan"})),
    *(("0.1 mm", {"resolution": text}, f"a resolution of {float(text):g} m, expected a positive")
      for text in ("0", "-0.05", "1e-5", "1.0e-30")),
    *(("in order", given, "expected 0 <= free_thresh <= occupied_thresh <= 1") for given in (
        {"occupied_thresh": 0.1, "free_thresh": 0.9}, {"occupied_thresh": 65, "free_thresh": 19.6},
        {"free_thresh": -1},
    )),
    ("aliases", {"a": "&a 1", "b": "*a"}, "an alias"),
    ("aliases", {"sizes": "[[1], 2]"}, "lists in lists"),
    *(("other formats", {"image": png(COLOURS, kind=kind)}, "expected a PGM, PPM, PBM or PNG file")
      for kind in ("GIF", "BMP", "JPEG", "TIFF")),
    *(("cut off", {"image": image}, "hall.png") for image in (
        b"P5 3 2 255\n\x00\x00", b"P5 -3 2 255\n", b"P2 3 2 255\n1 2 x 4 5 6", b"",
        b"P2 3 2 10\n1 2 3 4 11 300\n",
    )),
    ("`origin`", {"origin": "[2e6, 0, 0]"}, "a corner at 2000000 m, expected all within 1e+06"),
    ("path of the image", {"image": "none.pgm"}, "expected a PGM, PPM, PBM or PNG file"),
    ("path of the image", {"image": "hall.yaml"}, "expected a PGM, PPM, PBM or PNG file"),
    ("PGM", {"image": b"P5 20000 20000 255\n"}, "20000 x 20000 cells"),
    ("PGM", {"image": b"P2 4000 4000 255\n" + b"0 " * 16_000_000},
     "32000017 bytes in decimal numbers, expected at most"),
]


@pytest.mark.parametrize(("row", "given", "told"), REFUSED, ids=named(REFUSED))
def test_what_the_table_says_is_refused_by_name(tmp_path, row, given, told) -> None:
    with pytest.raises(InvalidMapError, match=r"^map file .*hall\.yaml: given .*, exp") as caught:
        read(tmp_path, **given)
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
        with pytest.raises(InvalidMapError, match=f"^map file .*{wrong.name}") as caught:
            read_map(wrong)
        assert "\n" not in str(caught.value)


def test_map_of_another_kind_of_file_is_refused_at_once(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for wrong, kind in (("/dev/zero", "a device"), (str(tmp_path / "pipe"), "a pipe")):
        with pytest.raises(InvalidMapError, match=f"^map file {wrong}: given {kind}, expected"):
            read_map(Path(wrong))
        with pytest.raises(InvalidMapError, match=f"given image {wrong}: {kind}, expected a re"):
            read(tmp_path, image=wrong)


def test_image_is_found_beside_the_file_or_by_an_absolute_path_whatever_it_ends_in(
    tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir("/")
    (tmp_path / "maps").mkdir()
    for name in ("HALL.PGM", "hall", "hall.txt", "17"):
        (tmp_path / name).write_bytes(png(GREYS))
        for image in (f"../{name}", str(tmp_path / name)):
            assert read(tmp_path / "maps", image=image).values.tolist() == VALUES
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(InvalidMapError, match=r"image .*/maps/~/hall"):
        read(tmp_path / "maps", image="~/hall")


def test_black_wall_is_occupied_where_unknown_is_free(tmp_path) -> None:
    for occupied in (1, 0.65):
        found = read(tmp_path, image=png(BLACK_AND_WHITE), occupied_thresh=occupied, free_thresh=0)
        for threshold in (0.01, 1.0):
            occupied_cells = found.grid(threshold, unknown_is_free=True).occupied
            assert occupied_cells.tolist() == [[False, False, True], [True, False, False]]


def test_grid_of_a_map_is_turned_with_its_origin(tmp_path) -> None:
    found = read(tmp_path, origin=[1.0, 2.0, 0.5 * math.pi], occupied_thresh=0.6)
    grid = found.grid(0.65, unknown_is_free=False)
    assert grid.origin == pytest.approx((1.0, 2.0, 0.5 * math.pi))
    # Third cell of the first row: along the grid's x axis, which is the world's y axis.
    np.testing.assert_allclose(grid.local(np.array([1.0 - 0.025, 2.0 + 0.125])), [2.5, 0.5])
    assert grid.occupied.tolist() == [[False, True, False], [True, True, True]]
    assert found.grid(0.65, unknown_is_free=True).occupied.tolist() == [
        [False, False, False], [True, True, False]
    ]


def test_each_row_stands_in_the_document() -> None:
    table = DOCUMENT.read_text(encoding="utf-8").split("## Map files, rule by rule")[1]
    table = table.split("\n## ")[0]
    for row in {row for row, *_ in SAME} | {row for row, *_ in REFUSED}:
        assert any(row in line.split("|")[1] for line in table.splitlines() if "|" in line), row
