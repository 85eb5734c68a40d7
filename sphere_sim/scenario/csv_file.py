# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: CSV in UTF-8 with a header and one row for each run, columns in any order.

``x, y, qw, qx, qy, qz`` are the start and ``goal_x ... goal_qz`` the goal. ``seed`` is optional;
by default it is the number of the row, counted from 0. ``push_x, push_y, push_time`` are a push,
and columns named like settings of the disturbances, such as ``slope``, have values for the run;
all these may be absent or empty. ``path`` is a CSV file of ``x, y`` beside this one, along which
the run leads to its last place, and ``path_speed`` the speed; the goal of such a run may be absent
or empty, and is not read. Other columns are copied to the results.
"""

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from sphere_nmpc.errors import InvalidParameterError, InvalidStateError
from sphere_nmpc.foreign_text import shown
from sphere_nmpc.model.rotation import NORM_TOLERANCE
from sphere_nmpc.model.state import FARTHEST, Vector, as_state
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.scenario.csv_table import MOST_FIELDS, CsvFileError, number, read_rows
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
PLACE_COLUMNS = ("x", "y")
"""Columns of a path."""

LARGEST_SEED = 2**31 - 1
"""Largest seed."""
STRONGEST_PUSH = 1e3
"""Largest component of a push [N s]."""
SHORTEST_PATH = 1e-3
"""Least distance of some place of a path from its first one [m]."""


def read_scenarios(path: Path) -> list[Scenario]:
    """Read all scenarios of a file; `CsvFileError` names what is wrong."""
    paths = _PathFiles(path)
    return [
        _row(path, line, fields, index, paths)
        for index, (line, fields) in enumerate(read_rows(path, _needed, "scenario"))
    ]


def _needed(names: Sequence[str]) -> Sequence[str]:
    return START_COLUMNS if PATH_COLUMN in names else STATE_COLUMNS


class _PathFiles:
    """Paths that scenarios name; each file is read once."""

    def __init__(self, scenarios: Path) -> None:
        self._scenarios = scenarios
        self._read: dict[Path, Vector] = {}

    def read(self, line: int, text: str) -> GivenPath:
        """Return the path that the scenario of a line names."""
        file = self._scenarios.parent.joinpath(os.path.expanduser(text)).absolute()
        try:
            if file not in self._read:
                self._read[file] = read_path(file)
                if sum(places.size for places in self._read.values()) > MOST_FIELDS:
                    given = f"paths of more than {MOST_FIELDS} coordinates"
                    raise CsvFileError(file, given, "fewer in all paths of a study")
        except CsvFileError as error:
            if error.line is not None:
                raise
            given = f"{shown(text)}, {error.given}"
            raise CsvFileError(
                self._scenarios, given, error.expected, line, PATH_COLUMN
            ) from None
        return GivenPath(self._read[file], file)


def read_path(path: Path) -> Vector:
    """Return the places of a path, shape (P, 2) [m]; `CsvFileError` names what is wrong."""
    places = np.array([
        [number(path, line, name, fields[name].strip(), FARTHEST, "m") for name in PLACE_COLUMNS]
        for line, fields in read_rows(path, lambda _: PLACE_COLUMNS, "place", plain=True)
    ])
    places.flags.writeable = False
    if np.max(np.abs(places - places[0])) < SHORTEST_PATH:
        raise CsvFileError(
            path, "one place", f"places that are {SHORTEST_PATH:g} m apart or more"
        )
    return places


def _row(
    path: Path, line: int, fields: dict[str, str], index: int, paths: _PathFiles
) -> Scenario:
    given = {name: fields.pop(name, "").strip() for name in STATE_COLUMNS}
    seed = _seed(path, line, fields.pop(SEED_COLUMN, "").strip(), index)
    start = _state(path, line, given, START_COLUMNS)
    named = fields.pop(PATH_COLUMN, "").strip()
    follows = paths.read(line, named) if named else None
    goal = _state(path, line, given, GOAL_COLUMNS) if follows is None else follows.end
    push = _push(path, line, {name: fields.pop(name, "").strip() for name in PUSH_COLUMNS})
    disturbances = _settings(path, line, fields, DisturbanceSettings, DISTURBANCE_COLUMNS)
    speed = _settings(path, line, fields, ControllerSettings, (PATH_SPEED_COLUMN,))
    return Scenario(
        start, goal, seed, fields, given, push, disturbances, follows, speed.get(PATH_SPEED_COLUMN)
    )


def _push(path: Path, line: int, texts: dict[str, str]) -> Push | None:
    if not any(texts.values()):
        return None
    *impulse, time = PUSH_COLUMNS
    east, north = (number(path, line, n, texts[n], STRONGEST_PUSH, "N s") for n in impulse)
    at = number(path, line, time, texts[time])
    if at < 0.0:
        raise CsvFileError(path, shown(texts[time]), "a time from 0 on [s]", line, time)
    return Push(at, (east, north))


def _settings(
    path: Path, line: int, fields: dict[str, str], kind: Callable[..., object],
    names: Sequence[str],
) -> dict[str, float]:
    """Take the columns of some settings of a kind out of the fields."""
    texts = {name: text for name in names if (text := fields.pop(name, "").strip())}
    values = {name: number(path, line, name, text) for name, text in texts.items()}
    try:
        if values:
            kind(**values)
    except InvalidParameterError as error:
        name = error.name
        raise CsvFileError(path, shown(texts[name]), error.expected, line, name) from None
    return values


def _state(path: Path, line: int, given: dict[str, str], names: tuple[str, ...]) -> Vector:
    limits = [FARTHEST] * 2 + [math.inf] * 4
    values = [
        number(path, line, name, given[name], most, "m")
        for name, most in zip(names, limits, strict=True)
    ]
    try:
        return as_state(values)
    except InvalidStateError:
        raise CsvFileError(
            path, f"a norm of {math.hypot(*values[2:]):.6g}",
            f"a quaternion of norm 1 within {NORM_TOLERANCE:g}",
            line, f"{names[2]} to {names[-1]}",
        ) from None


def _seed(path: Path, line: int, text: str, index: int) -> int:
    if not text:
        return index
    if not (text.isascii() and text.isdigit()) or int(text[:11]) > LARGEST_SEED:
        raise CsvFileError(
            path, shown(text), f"a whole number from 0 to {LARGEST_SEED}", line, SEED_COLUMN
        )
    return int(text)
