# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A damaged journal, whose valid lines count, and what a journal is compared by."""

import json
from pathlib import Path

import import_graph
import pytest

from sphere_sim.output.files import ResultFolderError
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.journal import _OF_RUNS, NAME, Journal, fingerprint
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


def opened(folder: Path, lines: list[str]) -> dict[int, RunRecord]:
    (folder / NAME).write_text("".join(line + "\n" for line in lines))
    with Journal(folder, FINGERPRINT) as journal:
        return journal.records


def texts(records: dict[int, RunRecord]) -> dict[int, str]:
    """Return records as they are written, which is to the bit."""
    return {index: record.as_json(index) for index, record in records.items()}


BAD = {
    "rubbish": lambda line: "rubbish",
    "deep": lambda line: "[" * 100_000,
    "run 77 of 4": lambda line: json.dumps(json.loads(line) | {"run": 77}),
    "no strategy": lambda line: json.dumps(json.loads(line) | {"results": {"settled": True}}),
    "error NaN": lambda line: line.replace('"final_error": ', '"final_error": NaN, "a": '),
    "t huge": lambda line: line.replace('"t": [0.0', '"t": [1e999'),
    "t too short": lambda line: line.replace('"t": [0.0, ', '"t": ['),
    "u not in pairs": lambda line: line.replace('"u": [[0.0, 0.0], ', '"u": [[0.0], '),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_line_is_one_warning_and_stays(tmp_path, lines, records, caplog, what) -> None:
    bad = BAD[what](lines[2])
    assert bad != lines[2]
    found = opened(tmp_path, [*lines[:2], bad, *lines[3:]])
    assert texts(found) == texts({i: record for i, record in enumerate(records) if i != 1})
    (warning,) = caplog.messages
    assert str(tmp_path / NAME) in warning and "(line 3)" in warning
    assert (tmp_path / NAME).read_text().splitlines()[2] == bad


def test_runs_are_added_after_damaged_lines(tmp_path, lines, records) -> None:
    (tmp_path / NAME).write_text("\n".join([*lines[:2], "rubbish", lines[3], lines[4][:50]]))
    with Journal(tmp_path, FINGERPRINT) as journal:
        assert journal.records.keys() == {0, 2}
        for index in (1, 3):
            journal.append(index, records[index])
    with Journal(tmp_path, FINGERPRINT) as journal:
        assert texts(journal.records) == texts(dict(enumerate(records)))


def test_journal_without_settings_is_refused_and_stays(tmp_path, lines) -> None:
    with pytest.raises(ResultFolderError, match=r"journal.jsonl, line 1: .* another folder"):
        opened(tmp_path, ["[]", *lines[1:]])
    assert len((tmp_path / NAME).read_text().splitlines()) == 5


def test_all_modules_that_a_run_may_import_count() -> None:
    graph, waiting = import_graph.module_graph(), ["sphere_sim.study.single_run"]
    found: set[str] = set()
    while waiting:
        found.add(module := waiting.pop())
        waiting += graph[module] - found
    packages = {name.split(".")[1] for name in found if name.startswith("sphere_sim.")}
    assert packages <= set(_OF_RUNS)
    assert not any(name.startswith("sphere_nmpc.ros") for name in found)
