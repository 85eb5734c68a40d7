# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: CSV in UTF-8 with a header and one row for each run, columns in any order.

``x, y, qw, qx, qy, qz`` are the start and ``goal_x ... goal_qz`` the goal. ``seed`` is optional;
by default it is the number of the row, counted from 0. ``push_x, push_y, push_time`` are a push,
and columns named like settings of the disturbances, such as ``slope``, have values for the run;
all these may be absent or empty. Other columns are copied to the results.
"""

import csv
import math
import stat
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from sphere_nmpc.errors import InvalidParameterError, InvalidStateError, SphereNmpcError
from sphere_nmpc.foreign_text import printable_line, shown
from sphere_nmpc.model.rotation import NORM_TOLERANCE
from sphere_nmpc.model.state import FARTHEST, Vector, as_state
from sphere_nmpc.quantity import counted
from sphere_sim.scenario.scenarios import DISTURBANCE_COLUMNS, PUSH_COLUMNS, Scenario
from sphere_sim.world.disturbances import DisturbanceSettings, Push

START_COLUMNS = ("x", "y", "qw", "qx", "qy", "qz")
GOAL_COLUMNS = tuple(f"goal_{name}" for name in START_COLUMNS)
STATE_COLUMNS = START_COLUMNS + GOAL_COLUMNS
SEED_COLUMN = "seed"

LARGEST_FILE = 2**28
"""Largest file that is read [bytes]."""
MOST_FIELDS = 12_000_000
"""Fields of all rows that are read: a million rows of the columns that have to be there, which
take 1.5 GB of memory."""
LARGEST_SEED = 2**31 - 1
"""Largest seed."""
STRONGEST_PUSH = 1e3
"""Largest component of a push [N s]."""


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
    """Read all scenarios of a file, at least one; `ScenarioFileError` names what is wrong."""
    rows = list(_scenarios(path))
    if not rows:
        raise ScenarioFileError(path, "a header alone", "at least one scenario")
    return rows


def read_places(path: Path, most: int) -> Vector:
    """Return the places [m] of a file, shape (P, 2), at most so many; raises as `read_scenarios`.

    There is one in a row, in the columns that a header names ``x`` and ``y``, or in the first two
    where there is no header.
    """
    columns: dict[str, int] = {}
    places: list[list[float]] = []
    for line, fields in _rows(path):
        if not columns:
            names = [text.strip() for text in fields]
            columns = {name: names.index(name) for name in ("x", "y") if name in names}
            if len(columns) == 2:
                continue
            columns = {"x": 0, "y": 1}
        if len(fields) <= max(columns.values()):
            raise ScenarioFileError(path, counted(len(fields), "field"), "x and y", line)
        if len(places) == most:
            raise ScenarioFileError(path, f"more than {most} places", f"at most {most}", line)
        places.append([_coordinate(path, line, name, fields[at]) for name, at in columns.items()])
    if not places:
        raise ScenarioFileError(path, "no place", "a row with x and y [m] for each place")
    return np.array(places)


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and fields of each row that is not empty."""
    try:
        _refuse_unreadable(path)
        # utf-8-sig: some spreadsheets write a byte order mark before the first name.
        with path.open(encoding="utf-8-sig", newline="") as file:
            yield from _rows_of(path, file)
    except UnicodeDecodeError as error:
        raise ScenarioFileError(
            path, f"the byte 0x{error.object[error.start]:02x}", "text encoded in UTF-8",
            _line_of_bad_byte(path),
        ) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioFileError(path, reason.lower(), "a CSV file that can be read") from None


def _refuse_unreadable(path: Path) -> None:
    """Raise an error for devices and pipes, which may have no end, and for too large files."""
    about = path.stat()
    kinds = {stat.S_ISDIR: "a directory", stat.S_ISFIFO: "a pipe", stat.S_ISREG: ""}
    given = next((kind for test, kind in kinds.items() if test(about.st_mode)), "a device")
    if given:
        raise ScenarioFileError(path, given, "a CSV file")
    if about.st_size > LARGEST_FILE:
        raise ScenarioFileError(
            path, f"{about.st_size / 2**20:.0f} MiB", f"at most {LARGEST_FILE / 2**20:.0f} MiB"
        )


def _rows_of(path: Path, file: TextIO) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(file, strict=True)
    while True:
        line = reader.line_num + 1
        try:
            fields = next(reader, None)
        except csv.Error as error:
            raise ScenarioFileError(path, str(error), "a row of CSV", line) from None
        if fields is None:
            return
        if any(text.strip() for text in fields):
            yield line, fields


def _scenarios(path: Path) -> Iterator[Scenario]:
    header: list[str] | None = None
    number = 0
    for line, fields in _rows(path):
        if header is None:
            header = _header(path, line, [text.strip() for text in fields])
            continue
        if len(fields) != len(header):
            raise ScenarioFileError(
                path, counted(len(fields), "field"), f"{len(header)}, as in the header", line
            )
        number += 1
        if number * len(header) > MOST_FIELDS:
            raise ScenarioFileError(
                path, f"more than {MOST_FIELDS} fields",
                f"at most {MOST_FIELDS // len(header)} rows of {len(header)} columns", line,
            )
        yield _row(path, line, dict(zip(header, fields, strict=True)), number - 1)
    if header is None:
        raise ScenarioFileError(path, "an empty file", f"a header {','.join(STATE_COLUMNS)}")


def _header(path: Path, line: int, names: list[str]) -> list[str]:
    for name in STATE_COLUMNS:
        if name not in names:
            raise ScenarioFileError(
                path, f"the columns {shown(','.join(names))}", "a column of this name", line, name
            )
    for name, times in Counter(names).items():
        if times > 1:
            raise ScenarioFileError(path, "a name twice", "each column once", line, name)
    return names


def _row(path: Path, line: int, fields: dict[str, str], number: int) -> Scenario:
    given = {name: fields.pop(name).strip() for name in STATE_COLUMNS}
    seed = _seed(path, line, fields.pop(SEED_COLUMN, "").strip(), number)
    start, goal = (_state(path, line, given, names) for names in (START_COLUMNS, GOAL_COLUMNS))
    push = _push(path, line, {name: fields.pop(name, "").strip() for name in PUSH_COLUMNS})
    values = {name: fields.pop(name, "").strip() for name in DISTURBANCE_COLUMNS}
    disturbances = _disturbances(path, line, {n: text for n, text in values.items() if text})
    return Scenario(start, goal, seed, fields, given, push, disturbances)


def _push(path: Path, line: int, texts: dict[str, str]) -> Push | None:
    if not any(texts.values()):
        return None
    east, north, time = (_number(path, line, name, text) for name, text in texts.items())
    for name, value in zip(PUSH_COLUMNS, (east, north), strict=False):
        if abs(value) > STRONGEST_PUSH:
            expected = f"-{STRONGEST_PUSH:g} to {STRONGEST_PUSH:g} [N s]"
            raise ScenarioFileError(path, shown(texts[name]), expected, line, name)
    if time < 0.0:
        name = PUSH_COLUMNS[-1]
        raise ScenarioFileError(path, shown(texts[name]), "a time from 0 on [s]", line, name)
    return Push(time, (east, north))


def _disturbances(path: Path, line: int, texts: dict[str, str]) -> dict[str, float]:
    values = {name: _number(path, line, name, text) for name, text in texts.items()}
    try:
        DisturbanceSettings(**values)
    except InvalidParameterError as error:
        name = error.name
        raise ScenarioFileError(path, shown(texts[name]), error.expected, line, name) from None
    return values


def _state(path: Path, line: int, given: dict[str, str], names: tuple[str, ...]) -> Vector:
    values = [_coordinate(path, line, name, given[name]) for name in names[:2]]
    values += [_number(path, line, name, given[name]) for name in names[2:]]
    try:
        return as_state(values)
    except InvalidStateError:
        raise ScenarioFileError(
            path, f"a norm of {math.hypot(*values[2:]):.6g}",
            f"a quaternion of norm 1 within {NORM_TOLERANCE:g}",
            line, f"{names[2]} to {names[-1]}",
        ) from None


def _coordinate(path: Path, line: int, name: str, text: str) -> float:
    value = _number(path, line, name, text)
    if abs(value) > FARTHEST:
        expected = f"-{FARTHEST:g} to {FARTHEST:g} [m]"
        raise ScenarioFileError(path, shown(text), expected, line, name)
    return value


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        # Python accepts 1_000, which other readers of CSV do not.
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ScenarioFileError(path, shown(text), "a finite number", line, name)
    return value


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
