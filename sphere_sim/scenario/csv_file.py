# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: CSV in UTF-8 with a header and one row for each run, columns in any order.

``x, y, qw, qx, qy, qz`` are the start and ``goal_x ... goal_qz`` the goal. ``seed`` is optional;
by default it is the number of the row, counted from 0. ``push_x, push_y, push_time`` are a push,
and columns named like settings of the disturbances, such as ``slope``, have values for the run;
all these may be absent or empty. ``path`` names a CSV file of ``x, y``, along which the run leads
to the last place, and ``path_speed`` is its speed; the goal of such a run may be absent or empty
and is not read. ``map`` names the map file of the run. Other columns are copied to the results.
"""

import contextlib
import csv
import io
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from sphere_nmpc.errors import (
    InvalidParameterError,
    InvalidStateError,
    SphereNmpcError,
    printable_line,
    shown,
)
from sphere_nmpc.floor.map_file import InvalidMapError, read_map
from sphere_nmpc.foreign.file import InvalidFileError, open_file
from sphere_nmpc.model.rotation import NORM_TOLERANCE
from sphere_nmpc.model.state import FARTHEST, Vector, as_state
from sphere_nmpc.quantities import counted
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.scenario.scenarios import (
    DISTURBANCE_COLUMNS,
    PATH_SPEED_COLUMN,
    PUSH_COLUMNS,
    GivenPath,
    Scenario,
)
from sphere_sim.world.disturbances import DisturbanceSettings, Push

START_COLUMNS = ("x", "y", "qw", "qx", "qy", "qz")
GOAL_COLUMNS = tuple(f"goal_{name}" for name in START_COLUMNS)
STATE_COLUMNS = START_COLUMNS + GOAL_COLUMNS
SEED_COLUMN = "seed"
PATH_COLUMN = "path"
MAP_COLUMN = "map"
PLACE_COLUMNS = ("x", "y")

LARGEST_FILE = 2**28
"""Largest file that is read [bytes]."""
MOST_FIELDS = 12_000_000
"""Fields of all rows that are read: a million rows of the columns that have to be there, which
take 1.5 GB of memory."""
LARGEST_SEED = 2**31 - 1
"""Largest seed."""
STRONGEST_PUSH = 1e3
"""Largest component of a push [N s]."""
SHORTEST_PATH = 1e-3
"""Least distance of some place of a path from its first one [m]."""

Row = tuple[int, dict[str, str]]
"""Line and texts by column."""


class ScenarioFileError(SphereNmpcError, ValueError):
    """A file of scenarios or places cannot be read or is invalid; lines are counted from 1."""

    exit_code = 2

    def __init__(
        self, path: Path, given: str, expected: str, line: int | None = None, column: str = ""
    ) -> None:
        where = str(path)
        if line is not None:
            where += f", line {line}"
        if column:
            where += f", column {column}"
        super().__init__(printable_line(f"{where}: given {given}, expected {expected}"))
        self.line = line
        self.column = column
        self.given = given
        self.expected = expected


def read_scenarios(path: Path) -> list[Scenario]:
    """Read all scenarios of a file; `ScenarioFileError` names what is wrong."""
    paths: dict[Path, Vector] = {}
    maps: set[Path] = set()
    with _opened(path) as file:
        return [
            _scenario(path, line, fields, index, paths, maps)
            for index, (line, fields) in enumerate(_rows(path, file, _needed_columns, "scenario"))
        ]


def _needed_columns(names: Sequence[str]) -> Sequence[str]:
    return START_COLUMNS if PATH_COLUMN in names else STATE_COLUMNS


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    """Open a file, and raise what cannot be read of it as `ScenarioFileError`."""
    try:
        # utf-8-sig: some spreadsheets write a byte order mark before the first name.
        stream = open_file(path, LARGEST_FILE)
        with io.TextIOWrapper(stream, encoding="utf-8-sig", newline="") as file:
            yield file
    except UnicodeDecodeError as error:
        raise ScenarioFileError(
            path, f"the byte 0x{error.object[error.start]:02x}", "text encoded in UTF-8",
            _line_of_bad_byte(path),
        ) from None
    except InvalidFileError as error:
        raise ScenarioFileError(path, str(error.given), error.expected) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioFileError(path, reason.lower(), "a CSV file that can be read") from None


def _rows(
    path: Path, file: TextIO, needed: Callable[[Sequence[str]], Sequence[str]], what: str,
    most: int | None = None,
) -> Iterator[Row]:
    """Yield all rows of a file, at least one, without blank ones.

    `needed` returns the columns that are needed beside given ones, `what` is what a row is, and
    `most` the number of fields; where it is given, numbers in the first row are no header.
    """
    reader = csv.reader(file, strict=True)
    header: Sequence[str] | None = None
    limit = MOST_FIELDS if most is None else most
    number = 0
    while True:
        line = reader.line_num + 1
        try:
            fields = next(reader, None)
        except csv.Error as error:
            raise ScenarioFileError(path, str(error), "a row of CSV", line) from None
        if fields is None:
            break
        if not any(text.strip() for text in fields):
            continue
        if header is None and most is not None and math.isfinite(_value(fields[0])):
            header = needed(())
        if header is None:
            header = [text.strip() for text in fields]
            _check_header(path, line, header, needed(header))
            continue
        if len(fields) != len(header):
            raise ScenarioFileError(
                path, counted(len(fields), "field"), f"{len(header)}, as in the header", line
            )
        number += 1
        if number * len(header) > limit:
            raise ScenarioFileError(
                path, f"more than {limit} fields",
                f"at most {limit // len(header)} rows of {len(header)} columns", line,
            )
        yield line, dict(zip(header, fields, strict=True))
    if header is None:
        raise ScenarioFileError(path, "an empty file", f"a header {','.join(needed(()))}")
    if not number:
        raise ScenarioFileError(path, "a header alone", f"at least one {what}")


def _check_header(path: Path, line: int, names: Sequence[str], needed: Sequence[str]) -> None:
    for name in needed:
        if name not in names:
            raise ScenarioFileError(
                path, f"the columns {shown(','.join(names))}", "a column of this name", line, name
            )
    for name, times in Counter(names).items():
        if times > 1:
            raise ScenarioFileError(path, "a name twice", "each column once", line, name)


def _scenario(
    path: Path, line: int, fields: dict[str, str], number: int, paths: dict[Path, Vector],
    maps: set[Path],
) -> Scenario:
    given = {name: fields.pop(name, "").strip() for name in STATE_COLUMNS}
    seed = _seed(path, line, fields.pop(SEED_COLUMN, "").strip(), number)
    start = _state(path, line, given, START_COLUMNS)
    named = fields.pop(PATH_COLUMN, "").strip()
    follows = _path(path, line, named, paths) if named else None
    goal = _state(path, line, given, GOAL_COLUMNS) if follows is None else follows.end
    push = _push(path, line, {name: fields.pop(name, "").strip() for name in PUSH_COLUMNS})
    disturbances = _settings(path, line, fields, DisturbanceSettings, DISTURBANCE_COLUMNS)
    speed = _settings(path, line, fields, ControllerSettings, (PATH_SPEED_COLUMN,))
    named = fields.pop(MAP_COLUMN, "").strip()
    map_file = _map(path, line, _beside(path, named), maps) if named else None
    return Scenario(
        start, goal, seed, fields, given, push, disturbances, follows,
        speed.get(PATH_SPEED_COLUMN), map_file,
    )


def _beside(path: Path, text: str) -> Path:
    """Return the file that a scenario of the file at `path` names."""
    return (path.parent / os.path.expanduser(text)).absolute()


def _map(path: Path, line: int, file: Path, known: set[Path]) -> Path:
    """Return the map file that a scenario names; each is read once, to see that it can be."""
    try:
        if file not in known:
            read_map(file)
    except InvalidMapError as error:
        given = f"{shown(file.name)}, {shown(error.given)}"
        raise ScenarioFileError(path, given, error.expected, line, MAP_COLUMN) from None
    known.add(file)
    return file


def _path(path: Path, line: int, text: str, known: dict[Path, Vector]) -> GivenPath:
    """Return the path that a scenario names; each file is read once."""
    file = _beside(path, text)
    try:
        if file not in known:
            most = MOST_FIELDS - sum(places.size for places in known.values())
            known[file] = read_places(file, most)
        if np.max(np.abs(known[file] - known[file][0])) < SHORTEST_PATH:
            raise ScenarioFileError(file, "one place", f"some {SHORTEST_PATH:g} m apart")
    except ScenarioFileError as error:
        if error.line is not None:
            raise
        given = f"{shown(text)}, {error.given}"
        raise ScenarioFileError(path, given, error.expected, line, PATH_COLUMN) from None
    return GivenPath(known[file], file)


def read_places(path: Path, most: int) -> Vector:
    """Return the places [m] in a file, of so many fields at most, shape (P, 2).

    The columns are ``x`` and ``y``, in this order where there is no header. `ScenarioFileError` is
    raised as by `read_scenarios`.
    """
    with _opened(path) as file:
        places = np.array([
            [_number(path, line, name, fields[name], FARTHEST) for name in PLACE_COLUMNS]
            for line, fields in _rows(path, file, lambda _: PLACE_COLUMNS, "place", most)
        ])
    places.flags.writeable = False
    return places


def _push(path: Path, line: int, texts: dict[str, str]) -> Push | None:
    if not any(texts.values()):
        return None
    limits = STRONGEST_PUSH, STRONGEST_PUSH, math.inf
    east, north, time = (
        _number(path, line, name, texts[name], most, "N s")
        for name, most in zip(PUSH_COLUMNS, limits, strict=True)
    )
    if time < 0.0:
        name = PUSH_COLUMNS[-1]
        raise ScenarioFileError(path, shown(texts[name]), "a time from 0 on [s]", line, name)
    return Push(time, (east, north))


def _settings(
    path: Path, line: int, fields: dict[str, str], kind: Callable[..., object],
    names: Sequence[str],
) -> dict[str, float]:
    """Take the columns of settings of a kind out of the fields."""
    texts = {name: text for name in names if (text := fields.pop(name, "").strip())}
    values = {name: _number(path, line, name, text) for name, text in texts.items()}
    try:
        if values:
            kind(**values)
    except InvalidParameterError as error:
        name = error.name
        raise ScenarioFileError(path, shown(texts[name]), error.expected, line, name) from None
    return values


def _state(path: Path, line: int, given: dict[str, str], names: tuple[str, ...]) -> Vector:
    limits = [FARTHEST] * 2 + [math.inf] * 4
    values = [
        _number(path, line, name, given[name], most)
        for name, most in zip(names, limits, strict=True)
    ]
    try:
        return as_state(values)
    except InvalidStateError:
        raise ScenarioFileError(
            path, f"a norm of {math.hypot(*values[2:]):.6g}",
            f"a quaternion of norm 1 within {NORM_TOLERANCE:g}",
            line, f"{names[2]} to {names[-1]}",
        ) from None


def _number(
    path: Path, line: int, name: str, text: str, most: float = math.inf, unit: str = "m"
) -> float:
    """Return a finite number, of at most this magnitude."""
    value = _value(text)
    if not math.isfinite(value):
        raise ScenarioFileError(path, shown(text), "a finite number", line, name)
    if abs(value) > most:
        raise ScenarioFileError(path, shown(text), f"-{most:g} to {most:g} [{unit}]", line, name)
    return value


def _value(text: str) -> float:
    try:
        # Python accepts 1_000, which other readers of CSV do not.
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan


def _seed(path: Path, line: int, text: str, number: int) -> int:
    if not text:
        return number
    if not (text.isascii() and text.isdigit()) or int(text[:11]) > LARGEST_SEED:
        raise ScenarioFileError(
            path, shown(text), f"a whole number from 0 to {LARGEST_SEED}", line, SEED_COLUMN
        )
    return int(text)


def _line_of_bad_byte(path: Path) -> int | None:
    try:
        path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        return error.object[: error.start].count(b"\n") + 1
    return None
