# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: what is accepted, and one error for what is not."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sphere_sim.scenario.csv_file import LARGEST_FILE, STATE_COLUMNS, read_scenarios
from sphere_sim.scenario.errors import ScenarioFileError
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.push import Push

HEADER = ",".join(STATE_COLUMNS)
ROW = "1,2,1,0,0,0,0,0,0,0,0,1"

coordinates = st.floats(-1e6, 1e6)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
names = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1).filter(
    lambda name: name not in (*STATE_COLUMNS, "seed") and name == name.strip()
)


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


def test_seed_is_the_number_of_the_row_where_it_is_left_out(tmp_path) -> None:
    assert [s.seed for s in read_scenarios(write(tmp_path, HEADER, ROW, ROW))] == [0, 1]
    found = read_scenarios(write(tmp_path, HEADER + ",seed", ROW + ",5", ROW + ","))
    assert [s.seed for s in found] == [5, 1]


def test_byte_order_mark_is_no_part_of_the_first_name(tmp_path) -> None:
    assert len(read_scenarios(write(tmp_path, HEADER, ROW, encoding="utf-8-sig"))) == 1


def test_paper_case_reads_as_the_built_in_one(tmp_path) -> None:
    path = write(tmp_path, HEADER, "2,-3,0.03,0.454,0.88,0.1363,0,0,1,0,0,0")
    (scenario,) = read_scenarios(path)
    np.testing.assert_array_equal(scenario.start, PAPER_CASES[1].start)
    assert scenario.given["qw"] == "0.03"


@given(
    ends=st.lists(st.tuples(coordinates, coordinates, quaternions), min_size=2, max_size=2),
    seed=st.integers(0, 2**31 - 1),
    extra=st.dictionaries(names, st.text(st.characters(codec="utf-8", exclude_characters="\0"))),
)
@settings(max_examples=40)
def test_what_is_written_is_what_is_read(tmp_path_factory, ends, seed, extra) -> None:
    path = tmp_path_factory.getbasetemp() / "round_trip.csv"
    states = [np.array([x, y, *q]) for x, y, q in ends]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*STATE_COLUMNS, "seed", *extra])
        writer.writerow([*map(repr, np.concatenate(states).tolist()), seed, *extra.values()])
    (scenario,) = read_scenarios(path)
    np.testing.assert_allclose(scenario.start, states[0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(scenario.goal, states[1], rtol=0, atol=1e-15)
    assert (scenario.seed, scenario.extra) == (seed, extra)


@given(
    column=st.sampled_from(STATE_COLUMNS),
    text=st.sampled_from(["nan", "inf", "-inf", "", "one", "1_0", "1;2", "0x1", "1e999"]),
    row=st.integers(0, 3),
)
@settings(max_examples=40)
def test_a_bad_number_is_named_by_line_and_column(tmp_path_factory, column, text, row) -> None:
    rows = [ROW.split(",") for _ in range(4)]
    rows[row][STATE_COLUMNS.index(column)] = text
    error = error_of(
        write(tmp_path_factory.getbasetemp(), HEADER, *(",".join(cells) for cells in rows))
    )
    assert (error.line, error.column, error.given) == (row + 2, column, f"'{text}'")


@given(st.binary(max_size=200), st.booleans())
@settings(max_examples=150)
def test_any_bytes_are_scenarios_or_the_one_error(tmp_path_factory, noise, headed) -> None:
    path = tmp_path_factory.getbasetemp() / "noise.csv"
    path.write_bytes((HEADER.encode() + b"\n" if headed else b"") + noise)
    try:
        assert read_scenarios(path)
    except ScenarioFileError as error:
        assert error.expected


def test_missing_column_is_named(tmp_path) -> None:
    error = error_of(write(tmp_path, HEADER.replace("goal_qy,", ""), ROW))
    assert (error.line, error.column) == (1, "goal_qy")


def test_column_twice_is_refused(tmp_path) -> None:
    assert error_of(write(tmp_path, HEADER + ",who,who", ROW + ",a,b")).column == "who"


def test_row_of_wrong_length_is_refused(tmp_path) -> None:
    error = error_of(write(tmp_path, HEADER, ROW, ROW + ",1"))
    assert (error.line, error.given) == (3, "13 fields")


def test_quaternion_off_the_unit_sphere_is_refused(tmp_path) -> None:
    error = error_of(write(tmp_path, HEADER, ROW, "0,0,1,0,0,0,0,0,1,1,0,0"))
    assert (error.line, error.column) == (3, "goal_qw to goal_qz")
    assert "1.41421" in error.given


def test_too_far_position_is_refused(tmp_path) -> None:
    assert error_of(write(tmp_path, HEADER, "1e7" + ROW[1:])).column == "x"


@pytest.mark.parametrize("text", ["-1", "1.5", "2147483648", "9" * 50, "x"])
def test_bad_seed_is_refused(tmp_path, text) -> None:
    error = error_of(write(tmp_path, HEADER + ",seed", ROW + "," + text))
    assert (error.line, error.column) == (2, "seed")


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


@pytest.mark.parametrize(
    ("column", "cells"),
    [
        ("push_time", {"push_x": "1", "push_y": "0"}),
        ("push_y", {"push_x": "1", "push_y": "far", "push_time": "1"}),
        ("push_x", {"push_x": "1e4", "push_y": "0", "push_time": "1"}),
        ("push_time", {"push_x": "1", "push_y": "0", "push_time": "-1"}),
        ("slope", {"slope": "2"}),
        ("mass_offset_z", {"mass_offset_z": "nan"}),
    ],
)
def test_bad_push_or_disturbance_is_named_by_its_column(tmp_path, column, cells) -> None:
    path = write(tmp_path, ",".join([HEADER, *cells]), ",".join([ROW, *cells.values()]))
    error = error_of(path)
    assert (error.line, error.column) == (2, column)


def test_empty_file_and_header_alone_are_refused(tmp_path) -> None:
    assert error_of(write(tmp_path)).given == "an empty file"
    assert error_of(write(tmp_path, HEADER)).given == "a header alone"


def test_wrong_encoding_is_refused_with_its_line(tmp_path) -> None:
    error = error_of(write(tmp_path, HEADER + ",who", ROW + ",näme", encoding="latin-1"))
    assert (error.line, error.given) == (2, "the byte 0xe4")


def test_missing_file_and_folder_are_refused(tmp_path) -> None:
    assert "no such file" in error_of(tmp_path / "none.csv").given
    assert error_of(tmp_path).given == "a directory"


def test_pipe_and_device_are_refused_unread(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert error_of(tmp_path / "pipe").given == "a pipe"
    assert error_of(Path("/dev/zero")).given == "a device"


def test_far_too_large_a_file_is_refused_unread(tmp_path) -> None:
    path = write(tmp_path, HEADER, ROW)
    os.truncate(path, 10 * 2**30)  # takes no space on the disk
    error = error_of(path)
    assert (error.given, error.expected) == ("10240 MiB", "at most 256 MiB")


@pytest.mark.parametrize("quote", ["", '"'])
def test_endless_line_is_refused_by_its_number(tmp_path, quote) -> None:
    path = write(tmp_path, HEADER + ",who", f"{ROW},{quote}")
    os.truncate(path, LARGEST_FILE)
    error = error_of(path)
    assert error.line == 3 and error.given == "an endless line"


def test_endless_cell_is_refused(tmp_path) -> None:
    error = error_of(write(tmp_path, HEADER + ",who", f"{ROW},{'x' * 200_000}"))
    assert error.line == 2 and "limit" in error.given
