# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A folder of results: its formats, its journal, how a study continues, what is refused."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import import_graph
import numpy as np
import pytest

from sphere_nmpc.model.goal import Orientation
from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.output.files import ResultFolderError
from sphere_sim.scenario.csv_file import START_COLUMNS, STATE_COLUMNS, read_scenarios
from sphere_sim.scenario.scenarios import GivenPath, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.figure import FIGURES
from sphere_sim.study.journal import _OF_RUNS, NAME, Journal, fingerprint
from sphere_sim.study.motion import Motion
from sphere_sim.study.record import (
    PATH_RESULT_COLUMNS,
    PUSH_RESULT_COLUMNS,
    RESULT_COLUMNS,
    RunRecord,
)
from sphere_sim.study.single_run import run_scenario
from sphere_sim.study.study import Study
from sphere_sim.study.workers import Workers
from sphere_sim.world.disturbances import Push

SCENARIOS = draw_scenarios(2, 1)
SCENARIOS += [replace(SCENARIOS[0], goal=SCENARIOS[0].start)]
"""Two that do not settle in time, and one that starts at its goal."""
SHORT = StudyConditions(duration=1.0).with_settings([("controller.strategy", "paper")])


def make(folder: Path, *how: Any, **changes: Any) -> dict[str, dict[str, Any]]:
    study = replace(Study(SCENARIOS, SHORT, folder), **changes)
    with Workers() as workers:
        return study.run(workers, *how)


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "runs.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def repeatable(folder: Path) -> list[dict[str, str]]:
    """Return the rows without the times of solves."""
    return [
        {name: cell for name, cell in row.items() if not name.startswith("solve_ms_")}
        for row in rows(folder)
    ]


@pytest.fixture(autouse=True)
def no_figure(monkeypatch) -> None:
    """Only the study of `done` is drawn: it takes longer than all the runs."""
    monkeypatch.setattr("sphere_sim.study.study.draw", lambda *arguments: None)


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "nested" / "folder"
    make(folder)
    return folder


def test_table_has_a_row_a_run_in_order(done) -> None:
    found = rows(done)
    assert list(found[0]) == [*STATE_COLUMNS, "seed", *RESULT_COLUMNS]
    for row, scenario in zip(found, SCENARIOS, strict=True):
        values = [float(row[name]) for name in STATE_COLUMNS]
        np.testing.assert_array_equal(values, [*scenario.start, *scenario.goal])
        assert int(row["seed"]) == scenario.seed
        assert row["bound_s"] == row["ratio"] == row["crash"] == ""
    assert [row["settled"] for row in found] == ["False", "False", "True"]
    assert [row["settle_time_s"] for row in found] == ["", "", "0.0"]
    assert [float(row["final_error"]) > SETTLED_ERROR for row in found] == [True, True, False]
    assert [(done / name).read_bytes()[:4] for name in FIGURES] == [b"%PDF", b"\x89PNG"]


def test_pushes_and_disturbances_are_columns_that_can_be_run_again(tmp_path) -> None:
    goal = replace(SCENARIOS[2], push=Push(0.5, (1e-9, 0.0)), disturbances={"slope": 0.0})
    scenarios = [goal, SCENARIOS[0]]
    make(tmp_path / "first", scenarios=scenarios)
    optional = ["push_x", "push_y", "push_time", "slope"]
    found, other = rows(tmp_path / "first")
    columns = [*STATE_COLUMNS, "seed", *optional, *RESULT_COLUMNS, *PUSH_RESULT_COLUMNS]
    assert list(found) == columns
    assert [found[name] for name in optional] == ["1e-09", "0.0", "0.5", "0.0"]
    assert (found["settled"], found["recover_s"]) == ("True", "0.0")
    assert [other[name] for name in (*optional, "recover_s")] == [""] * 5
    again = read_scenarios(tmp_path / "first" / "runs.csv")
    assert [s.optional for s in again] == [s.optional for s in scenarios]
    make(tmp_path / "second", scenarios=again)
    assert list(rows(tmp_path / "second")[0]) == columns
    summary = json.loads((tmp_path / "first" / "summary.json").read_text())
    assert summary["recover_s"]["count"] == 1


def test_path_and_its_speed_are_columns_that_can_be_run_again(tmp_path) -> None:
    (tmp_path / "in").mkdir()
    places = np.array([(0.0, 0.0), (0.004, 0.0), (0.0, 0.0)])
    (tmp_path / "in" / "way.csv").write_text("\n".join(f"{x},{y}" for x, y in places))
    cells = "0,0,1,0,0,0,in/way.csv"
    (tmp_path / "cases.csv").write_text(f"{','.join(START_COLUMNS)},path,path_speed\n{cells},0.3")
    scenarios = [*read_scenarios(tmp_path / "cases.csv"), SCENARIOS[2]]
    known = []
    make(tmp_path / "out", lambda motions: known.extend(motions) or [0.5], scenarios=scenarios)
    assert [motion.orientation for motion in known] == [Orientation.FULL]
    found, other = rows(tmp_path / "out")
    assert [*found][-3:] == list(PATH_RESULT_COLUMNS)
    assert (found["path"], found["path_speed"]) == ("../in/way.csv", "0.3")
    assert [found[name] for name in ("goal_x", "goal_qz", "bound_s", "lower_bound_s")] == [""] * 4
    assert found["path_max_m"] and found["crash"] == ""
    assert [other[name] for name in ("path", "path_speed", *PATH_RESULT_COLUMNS)] == [""] * 5
    again = read_scenarios(tmp_path / "out" / "runs.csv")
    other_way = replace(again[0], follows=GivenPath(places[:2], tmp_path))
    digests = [fingerprint(SHORT, [one])["scenarios"] for one in (again[0], other_way)]
    assert digests[0] != digests[1]
    make(tmp_path / "again", scenarios=again)
    first, second = repeatable(tmp_path / "out"), repeatable(tmp_path / "again")
    assert first[0] == second[0]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["path_max_m"]["count"] == 1


def test_stopped_study_continues_with_the_same_results(done, tmp_path) -> None:
    seen = []

    def stop_after_two(record: RunRecord) -> None:
        seen.append(record)
        if len(seen) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, None, stop_after_two)
    assert not (tmp_path / "runs.csv").exists()
    journal = tmp_path / "journal.jsonl"
    assert len(journal.read_bytes().splitlines()) == 3
    # The second run was being written when everything stopped.
    journal.write_bytes(journal.read_bytes()[:-40])
    seen.clear()
    make(tmp_path, None, seen.append)
    assert len(seen) == 3
    assert repeatable(tmp_path) == repeatable(done)
    assert (tmp_path / "inputs.npz").read_bytes() == (done / "inputs.npz").read_bytes()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"conditions": replace(SHORT, perturbation=1.0)}, "perturbation: given 1.0, recorded 0"),
        ({"scenarios": SCENARIOS[:2]}, "runs: given 2, recorded 3"),
        ({"scenarios": draw_scenarios(3, 2)}, "other scenarios"),
        ({"strategies": ("paper", "time_optimal")}, "other results"),
    ],
)
def test_other_study_in_the_folder_is_refused_and_nothing_lost(done, changes, words) -> None:
    before = {path.name: path.read_bytes() for path in done.iterdir()}
    with pytest.raises(ResultFolderError, match=words):
        make(done, **changes)
    assert before == {path.name: path.read_bytes() for path in done.iterdir()}


def test_two_studies_do_not_write_into_one_folder(tmp_path) -> None:
    refused = []

    def second(record: RunRecord) -> None:
        with pytest.raises(ResultFolderError, match="another study is writing") as caught:
            make(tmp_path)
        refused.append(caught.value)

    make(tmp_path, None, second, scenarios=SCENARIOS[:1])
    assert len(refused) == 1


def test_strategies_side_by_side_keep_the_layout_of_one(done, tmp_path) -> None:
    summaries = make(tmp_path, strategies=("paper", "time_optimal"))
    assert list(summaries) == ["paper", "time_optimal"]
    paper, both = repeatable(tmp_path / "paper"), repeatable(tmp_path)
    assert paper == repeatable(done) == both[:3]
    assert [row["strategy"] for row in both] == ["paper"] * 3 + ["time_optimal"] * 3


def test_ratio_of_a_pushed_run_counts_from_the_push_for_each_strategy(tmp_path) -> None:
    at_goal = replace(SCENARIOS[2], push=Push(0.5, (1e-9, 0.0)))
    seen: list[Motion] = []

    def best_known(motions: list[Motion]) -> list[float]:
        seen.extend(motions)
        return [0.5 * (i + 1) for i in range(len(motions))]

    pair = ("paper", "time_optimal")
    make(tmp_path, best_known, scenarios=[at_goal, SCENARIOS[2]], strategies=pair)
    assert [motion.starts_in_model_of_paper for motion in seen] == [False, True] * 2
    assert [row["bound_s"] for row in rows(tmp_path)] == ["0.5", "1.0", "1.5", "2.0"]
    assert [row["ratio"] for row in rows(tmp_path / "time_optimal")] == ["0.0"] * 2


def test_search_that_is_stopped_leaves_all_other_results(done, tmp_path) -> None:
    def best_known(motions: list[Motion]) -> list[float]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, best_known)
    assert repeatable(tmp_path) == repeatable(done)
    assert json.loads((tmp_path / "summary.json").read_text())["runs"] == 3
    assert (tmp_path / "inputs.npz").read_bytes() == (done / "inputs.npz").read_bytes()


FOUR = draw_scenarios(4, 1)
FINGERPRINT = fingerprint(SHORT, FOUR)


@pytest.fixture(scope="module")
def records() -> list[RunRecord]:
    return [run_scenario(SHORT, scenario) for scenario in FOUR]


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
