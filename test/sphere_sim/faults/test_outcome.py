# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Trials of one fault are one row, and the file holds what scripts expect."""

import json
import math

import pytest

from sphere_sim.faults.outcome import (
    Outcome,
    OutcomesUnreadableError,
    read_outcomes,
    rows,
    write_json,
)

CAMPAIGN = {"seed": 3, "plant": "rolling"}

OUTCOMES = [
    Outcome("blind", 2.0, 90.0, 300.0),
    Outcome("frame", 1.0, 50.0, 100.0),
    Outcome("blind", math.nan, 100.0, 200.0, ("not at the goal",)),
    Outcome("blind", 3.5, 80.0, 400.0, ("not at the goal", "nothing was recorded")),
]


def test_trials_of_a_fault_are_one_row_in_the_order_of_the_first() -> None:
    blind, frame = rows(OUTCOMES)
    assert (blind.fault, len(blind.outcomes), blind.survived) == ("blind", 3, 1)
    assert (frame.fault, len(frame.outcomes), frame.survived) == ("frame", 1, 1)


def test_longest_recovery_counts_and_each_complaint_is_listed_once() -> None:
    blind, _ = rows(OUTCOMES)
    assert blind.recovery == 3.5
    assert blind.complaints == ["not at the goal", "nothing was recorded"]


def test_file_holds_the_worst_of_each_fault(tmp_path) -> None:
    path = tmp_path / "new" / "faults.json"
    write_json(path, OUTCOMES, CAMPAIGN)
    assert json.loads(path.read_text())["faults"] == [
        {"fault": "blind", "tried": 3, "survived": 1, "recover_s": 3.5, "recover_median_s": 2.75,
         "worst_speed": 100.0, "worst_slew": 400.0},
        {"fault": "frame", "tried": 1, "survived": 1, "recover_s": 1.0, "recover_median_s": 1.0,
         "worst_speed": 50.0, "worst_slew": 100.0},
    ]
    assert [entry.name for entry in path.parent.iterdir()] == ["faults.json"]


def test_goal_that_was_never_reached_is_null_in_the_file(tmp_path) -> None:
    write_json(tmp_path / "f.json", [Outcome("lost", complaints=("not at the goal",))], CAMPAIGN)
    (row,) = json.loads((tmp_path / "f.json").read_text())["faults"]
    assert row["recover_s"] is None and row["survived"] == 0


def test_trials_of_a_file_are_those_that_were_written(tmp_path) -> None:
    path = tmp_path / "f.json"
    assert read_outcomes(path, CAMPAIGN) == []
    write_json(path, OUTCOMES, CAMPAIGN)
    read = read_outcomes(path, CAMPAIGN)
    assert [repr(outcome) for outcome in read] == [repr(outcome) for outcome in OUTCOMES]


def test_trials_of_another_campaign_are_refused(tmp_path) -> None:
    path = tmp_path / "f.json"
    write_json(path, OUTCOMES, CAMPAIGN | {"seed": 4})
    with pytest.raises(OutcomesUnreadableError, match=r"'seed': 4.*expected.*'seed': 3"):
        read_outcomes(path, CAMPAIGN)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"campaign": {}, "trials": [{"fault": 1}]}'])
def test_file_of_another_kind_is_refused(tmp_path, text) -> None:
    path = tmp_path / "f.json"
    path.write_text(text)
    with pytest.raises(OutcomesUnreadableError, match="cannot be continued"):
        read_outcomes(path, CAMPAIGN)
