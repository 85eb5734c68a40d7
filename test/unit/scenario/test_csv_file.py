# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: what is accepted, and one error for what is not."""

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.floor.settings import FloorSettings
from sphere_sim.scenario import csv_file
from sphere_sim.scenario.csv_file import (
    GOAL_COLUMNS,
    START_COLUMNS,
    STATE_COLUMNS,
    ScenarioFileError,
    read_scenarios,
)
from sphere_sim.world.disturbances import Push

HEADER = ",".join(STATE_COLUMNS)
ROW = "1,2,1,0,0,0,0,0,0,0,0,1"


def write(folder: Path, *lines: str, encoding: str = "utf-8") -> Path:
    path = folder / "scenarios.csv"
    path.write_bytes("".join(line + "\n" for line in lines).encode(encoding))
    return path


def error_of(path: Path) -> ScenarioFileError:
    with pytest.raises(ScenarioFileError) as caught:
        read_scenarios(path)
    assert str(path) in str(caught.value)
    assert "given" in str(caught.value) and "expected" in str(caught.value)
    return caught.value


def test_columns_may_come_in_any_order_with_extras_and_blank_lines(tmp_path) -> None:
    order = [*reversed(STATE_COLUMNS), "who", "seed"]
    cells = [*reversed(ROW.split(",")), "näme, with comma", "7"]
    path = tmp_path / "scenarios.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([order, [], cells])
    (scenario,) = read_scenarios(path)
    np.testing.assert_array_equal(scenario.start, [1, 2, 1, 0, 0, 0])
    np.testing.assert_array_equal(scenario.goal, [0, 0, 0, 0, 0, 1])
    assert (scenario.seed, scenario.extra) == (7, {"who": "näme, with comma"})


def test_rows_are_as_many_as_fit_into_memory(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(csv_file, "MOST_FIELDS", 3 * 12)
    read = read_scenarios(write(tmp_path, HEADER, ROW, ROW, ROW))
    assert [one.seed for one in read] == [0, 1, 2]
    error = error_of(write(tmp_path, HEADER, *[ROW] * 4))
    assert error.line == 5 and error.given == "more than 36 fields"
    error = error_of(write(tmp_path, HEADER + ",who", *[ROW + ","] * 3))
    assert error.line == 4 and error.expected == "at most 2 rows of 13 columns"


@pytest.mark.parametrize(
    ("lines", "line", "column", "given"),
    [
        ([], None, "", "an empty file"),
        ([HEADER], None, "", "a header alone"),
        ([HEADER.replace("goal_qy,", ""), ROW], 1, "goal_qy", "the columns"),
        ([HEADER + ",who,who", ROW + ",a,b"], 1, "who", "a name twice"),
        ([HEADER, ROW, ROW + ",1"], 3, "", "13 fields"),
        ([HEADER, ROW, "0,0,1,0,0,0,0,0,1,1,0,0"], 3, "goal_qw to goal_qz", "a norm of 1.41421"),
        ([HEADER, "1e7" + ROW[1:]], 2, "x", "'1e7'"),
        ([HEADER, ROW, "nan" + ROW[1:]], 3, "x", "'nan'"),
        ([HEADER + ",seed", ROW + ",1.5"], 2, "seed", "'1.5'"),
        ([HEADER + ",seed", ROW + ",2147483648"], 2, "seed", "'214748364"),
        ([HEADER + ",who", f"{ROW},{'x' * 200_000}"], 2, "", "field larger than field limit"),
        ([HEADER + ",push_x,push_y", ROW + ",1,0"], 2, "push_time", ""),
        ([HEADER + ",push_x,push_y,push_time", ROW + ",1,far,1"], 2, "push_y", "'far'"),
        ([HEADER + ",slope", ROW + ",2"], 2, "slope", ""),
    ],
)
def test_bad_file_is_refused_with_line_and_column(tmp_path, lines, line, column, given) -> None:
    error = error_of(write(tmp_path, *lines))
    assert (error.line, error.column) == (line, column)
    assert error.given.startswith(given)


def test_push_and_disturbances_are_optional_columns_and_may_be_empty(tmp_path) -> None:
    header = f"{HEADER},push_x,push_y,push_time,slope,mass_offset_y,who"
    rows = [f"{ROW},0.5,-0.25,1.5,0.01,,a", f"{ROW},,,,,1e-3,b", f"{ROW},,,,,,"]
    pushed, offset, plain = read_scenarios(write(tmp_path, header, *rows))
    assert pushed.push == Push(1.5, (0.5, -0.25)) and pushed.disturbances == {"slope": 0.01}
    assert offset.push is None and offset.disturbances == {"mass_offset_y": 1e-3}
    assert plain.push is None and plain.disturbances == {} and plain.extra == {"who": ""}
    assert list(pushed.optional.items()) == [
        ("push_x", 0.5), ("push_y", -0.25), ("push_time", 1.5), ("slope", 0.01)
    ]


def with_path(folder: Path, text: str, *places: str) -> Path:
    (folder / "way.csv").write_text("\n".join(places))
    goal = "," * len(GOAL_COLUMNS)
    header = HEADER + ",path,path_speed"
    return write(folder, header, f"{ROW[:12]}{goal}{text},0.3", f"{ROW},,", f"{ROW},way.csv,")


def test_path_is_read_beside_the_scenarios_and_needs_no_goal(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir("/")
    path = with_path(tmp_path, "way.csv", "who, y, x", "a, 0, 1", "", "b, 0.5, 2")
    along, plain, again = read_scenarios(path)
    np.testing.assert_array_equal(along.follows.places, [[1, 0], [2, 0.5]])
    np.testing.assert_array_equal(along.goal, [2, 0.5, 1, 0, 0, 0])
    assert (along.path_speed, again.path_speed) == (0.3, None)
    assert along.follows.file == tmp_path / "way.csv" and plain.follows is None
    assert again.follows.places is along.follows.places, "each file is read once"
    legs = along.course(0.02, 0.3).legs
    assert [leg.follows.tolerance for leg in legs] == [0.02]
    np.testing.assert_allclose(legs[0].follows.places[[0, -1]], along.follows.places, atol=1e-12)
    with_path(tmp_path, "way.csv", "1,0", "2,0.5")
    start, cells = ",".join(START_COLUMNS), ROW[:11]
    (short,) = read_scenarios(write(tmp_path, f"{start},path", f"{cells},{tmp_path}/way.csv"))
    np.testing.assert_array_equal(short.follows.places, [[1, 0], [2, 0.5]])


@pytest.mark.parametrize(
    ("places", "line", "column", "given"),
    [
        (["x,z", "1,2"], 1, "y", "the columns 'x,z'"),
        (["1,2", "3,4,5"], 2, "", "3 fields"),
        (["x,y", "1,2", "3,1e7"], 3, "y", "'1e7'"),
        (["x,y", "1,inf", "3,1"], 2, "y", "'inf'"),
        (["x,y", "1,2", "1.0005,2"], 2, "path", "'way.csv', one place"),
        (["x,y"], 2, "path", "'way.csv', a header alone"),
        ([], 2, "path", "'way.csv', an empty file"),
    ],
)
def test_bad_path_is_refused_with_its_line(tmp_path, places, line, column, given) -> None:
    with pytest.raises(ScenarioFileError) as caught:
        read_scenarios(with_path(tmp_path, "way.csv", *places))
    named = "scenarios.csv" if column == "path" else "way.csv"
    assert str(caught.value).startswith(f"{tmp_path / named}, line {line}")
    assert caught.value.column == column and caught.value.given.startswith(given)


def test_path_that_cannot_be_read_is_an_error_of_its_scenario(tmp_path, monkeypatch) -> None:
    for text in ("none.csv", "/dev/zero", "."):
        error = error_of(with_path(tmp_path, text, "0,0", "1,0"))
        assert (error.line, error.column) == (2, "path") and error.given.startswith(repr(text))
    monkeypatch.setattr(csv_file, "MOST_FIELDS", 3 * 14)
    with pytest.raises(ScenarioFileError, match=r"way\.csv, line 22: given more than 42 fields"):
        read_scenarios(with_path(tmp_path, "way.csv", *["0,0", "1,0"] * 12))
    header = HEADER + ",path,path_speed"
    for cells, column in ((",,-1", "path_speed"), (",,fast", "path_speed")):
        assert error_of(write(tmp_path, header, ROW + cells)).column == column
    without = HEADER.replace(",goal_x", "") + ",path"
    assert error_of(write(tmp_path, without, ROW[:-2] + ",")).column == "goal_x"


def test_what_is_no_file_is_refused_unread(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, expected in (
        (tmp_path / "none.csv", "no such file or directory"), (tmp_path, "a folder"),
        (tmp_path / "pipe", "a pipe"), (Path("/dev/zero"), "a device"),
    ):
        assert error_of(path).given == expected


def test_map_is_beside_the_scenarios_and_has_to_be_one(tmp_path) -> None:
    (tmp_path / "room.pgm").write_bytes(b"P5\n2 1\n255\n\xff\x00")
    (tmp_path / "room.yaml").write_text("image: room.pgm\nresolution: 0.5\norigin: [0, 0, 0]\n")
    rows = [f"{ROW},{name}" for name in ("room.yaml", " ", tmp_path / "room.yaml")]
    own, none, absolute = read_scenarios(write(tmp_path, HEADER + ",map", *rows))
    run = FloorSettings(map_file="run.yaml", clearance=0.1)
    assert none.floor(run) is run and own.floor(run) == absolute.floor(run)
    assert own.floor(run) == replace(run, map_file=str(tmp_path / "room.yaml"))
    (tmp_path / "room.pgm").unlink()
    for name in ("none.yaml", "room.yaml"):
        error = error_of(write(tmp_path, HEADER + ",map", f"{ROW},", f"{ROW},{name}"))
        assert (error.line, error.column) == (3, "map") and error.given.startswith(f"'{name}', ")
