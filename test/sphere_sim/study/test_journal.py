# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A damaged journal: valid lines count, missing runs are made again."""

import json
from pathlib import Path

import numpy as np
import pytest

from sphere_sim.output.result_folder import ResultFolderError
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.fingerprint import fingerprint
from sphere_sim.study.journal import NAME, Journal
from sphere_sim.study.record import RunRecord
from sphere_sim.study.single_run import run_scenario

SCENARIOS = draw_scenarios(4, 1)
SHORT = StudyConditions(duration=0.5).with_settings([("controller.strategy", "paper")])
FINGERPRINT = fingerprint(SHORT, SCENARIOS)


@pytest.fixture(scope="module")
def records() -> list[RunRecord]:
    return [run_scenario(SHORT, scenario) for scenario in SCENARIOS]


@pytest.fixture
def lines(tmp_path, records) -> list[str]:
    """Return the lines of a whole journal."""
    with Journal(tmp_path, FINGERPRINT) as journal:
        for index, record in enumerate(records):
            journal.append(index, record)
    return (tmp_path / NAME).read_text().splitlines()


def damaged(line: str, **changes: object) -> str:
    return json.dumps({**json.loads(line), **changes})


def opened(folder: Path, lines: list[str]) -> dict[int, RunRecord]:
    (folder / NAME).write_text("".join(line + "\n" for line in lines))
    with Journal(folder, FINGERPRINT) as journal:
        return journal.records


BAD = {
    "rubbish": lambda line: "rubbish",
    "nothing": lambda line: "",
    "zeros": lambda line: "\0" * 1000,
    "a list": lambda line: "[]",
    "deep": lambda line: "[" * 100_000,
    "cut short": lambda line: line[:-40],
    "two in one": lambda line: line[:-40] + line,
    "run 77 of 4": lambda line: damaged(line, run=77),
    "run -1": lambda line: damaged(line, run=-1),
    "run true": lambda line: damaged(line, run=True),
    "run 1.0": lambda line: damaged(line, run=1.0),
    "no strategy": lambda line: damaged(line, results={"settled": True}),
    "results a list": lambda line: damaged(line, results=["strategy", "settled"]),
    "settled a text": lambda line: line.replace('"settled": false', '"settled": "false"'),
    "error a list": lambda line: line.replace('"final_error": ', '"tail_error_p95": [], "a": '),
    "error NaN": lambda line: line.replace('"final_error": ', '"final_error": NaN, "a": '),
    "t NaN": lambda line: line.replace('"t": [0.0', '"t": [NaN'),
    "t huge": lambda line: line.replace('"t": [0.0', '"t": [1e999'),
    "t a text": lambda line: line.replace('"t": [0.0', '"t": ["0.0"'),
    "t too short": lambda line: line.replace('"t": [0.0, ', '"t": ['),
    "u not in pairs": lambda line: line.replace('"u": [[0.0, 0.0], ', '"u": [[0.0], '),
    "u flat": lambda line: damaged(line, u=np.ravel(json.loads(line)["u"]).tolist()),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_line_is_one_warning_and_stays(tmp_path, lines, records, caplog, what) -> None:
    bad = BAD[what](lines[2])
    assert bad != lines[2]
    found = opened(tmp_path, [*lines[:2], bad, *lines[3:]])
    assert found == {i: record for i, record in enumerate(records) if i != 1}
    (warning,) = caplog.messages
    assert str(tmp_path / NAME) in warning and "(line 3)" in warning
    assert (tmp_path / NAME).read_text().splitlines()[2] == bad


def test_many_bad_lines_are_one_warning(tmp_path, lines, caplog) -> None:
    opened(tmp_path, [*lines, *["rubbish"] * 100])
    assert "(line 6, 7, 8, 9, 10 and 95 more)" in caplog.text and len(caplog.messages) == 1


def test_run_that_is_recorded_twice_counts_once(tmp_path, lines, records, caplog) -> None:
    assert opened(tmp_path, [*lines, *lines[1:]]) == dict(enumerate(records))
    assert not caplog.messages


def test_runs_are_added_after_damaged_lines(tmp_path, lines, records) -> None:
    (tmp_path / NAME).write_text("\n".join([*lines[:2], "rubbish", lines[3], lines[4][:50]]))
    with Journal(tmp_path, FINGERPRINT) as journal:
        assert journal.records.keys() == {0, 2}
        for index in (1, 3):
            journal.append(index, records[index])
    with Journal(tmp_path, FINGERPRINT) as journal:
        assert journal.records == dict(enumerate(records))


@pytest.mark.parametrize("first", ["", "rubbish", "[]", "1", "{", "[" * 100_000])
def test_journal_without_settings_is_refused_and_stays(tmp_path, lines, first) -> None:
    with pytest.raises(ResultFolderError, match=r"journal.jsonl, line 1: .* another folder"):
        opened(tmp_path, [first, *lines[1:]])
    assert len((tmp_path / NAME).read_text().splitlines()) == 5
