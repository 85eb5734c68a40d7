# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: what is accepted, and one error for what is not."""

import csv
import os
import re
from pathlib import Path

import numpy as np
import pytest

from sphere_sim.scenario import csv_file
from sphere_sim.scenario.csv_file import (
    STATE_COLUMNS,
    ScenarioFileError,
    read_places,
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


def test_places_are_those_of_the_columns_x_and_y_or_of_the_first_two(tmp_path) -> None:
    for lines in (("1,2", "", "3,-4.5"), ("x,y", "1,2", "3,-4.5"),
                  ("t, y ,yaw,x", "0,2,9,1", "1,-4.5,9,3"), ("1,2,5,6", "3,-4.5,7,8")):
        assert read_places(write(tmp_path, *lines), 2).tolist() == [[1.0, 2.0], [3.0, -4.5]]


@pytest.mark.parametrize(("lines", "told"), [
    ((), "given no place, expected a row with x and y"), (("x,y",), "given no place"),
    (("a,b", "1,2"), "line 1, column x: given 'a', expected a finite number"),
    (("1,2", "3"), "line 2: given 1 field, expected x and y"),
    (("1,2", "3,nan"), "line 2, column y: given 'nan', expected a finite number"),
    (("x,y", "3,1e7"), "line 2, column y: given '1e7', expected -1e+06 to 1e+06 [m]"),
    (("1,2",) * 4, "line 4: given more than 3 places, expected at most 3"),
])
def test_file_without_valid_places_is_refused(tmp_path, lines, told) -> None:
    with pytest.raises(ScenarioFileError, match=re.escape(told)):
        read_places(write(tmp_path, *lines), 3)


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


def test_what_is_no_file_is_refused_unread(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, expected in (
        (tmp_path / "none.csv", "no such file or directory"), (tmp_path, "a directory"),
        (tmp_path / "pipe", "a pipe"), (Path("/dev/zero"), "a device"),
    ):
        assert error_of(path).given == expected
