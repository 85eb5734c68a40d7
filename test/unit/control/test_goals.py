# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals as a file keeps them and as a status tells them, and when one of them is given up."""

import math
from pathlib import Path

import pytest

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.control.goal_memory import goal_memory
from sphere_nmpc.control.goal_report import GoalReport, Patience
from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.foreign import own_folder
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import as_state
from sphere_nmpc.reporting.conditions import Kind

POSES = [as_state([1.0, -2.0, 0.0, 0.6, 0.8, 0.0]), as_state([0.1, 0.2, 1.0, 0.0, 0.0, 0.0])]
GOALS = ActiveCourse(Course.of(Goal(POSES[0]), Goal(POSES[1], Orientation.ANY_HEADING)), 42, 1)
STAMP = 12_345_678_901


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "goals" / "0.controller.json"


def test_goal_is_resumed_for_some_time_and_on_the_same_clock_only(path, monkeypatch) -> None:
    memory = goal_memory(path, 30.0)
    for simulated in (False, True):
        memory.save(GOALS, STAMP, simulated)
        assert memory.recall(STAMP, simulated) is not None
        assert memory.recall(STAMP, not simulated) is None
        assert memory.recall(STAMP - 1, simulated) is None, "the clock was set back"
    written = path.stat().st_mtime
    monkeypatch.setattr(own_folder.time, "time", lambda: written + 30.0)
    found = goal_memory(path, 30.0).recall(STAMP, True)
    assert found is not None and found[1] == 30.0
    assert found[0].course.is_listed_in(GOALS.course)
    assert (found[0].stamp, found[0].index) == (42, 1)
    assert goal_memory(path, 29.0).recall(STAMP, True) is None
    path.parent.chmod(0o777)
    with pytest.raises(OSError, match="a folder that others can write"):
        memory.recall(STAMP, True)
    path.parent.chmod(0o700)
    memory.save(None, STAMP, True)
    assert memory.recall(STAMP, True) is None and not list(path.parent.iterdir())


UPRIGHT = '["full", 0, 0, 1, 0, 0, 0]'


def content(goal: str, index: str = "0", stamp: str = "0") -> str:
    return (
        f'{{"goals": [{goal}], "goal_stamp": 0, "index": {index}, "stamp": {stamp}, '
        '"simulated": true}'
    )


@pytest.mark.parametrize(
    ("text", "is_valid"),
    [
        (content(UPRIGHT), True), ("", False), ("[]", False), ("null", False),
        (content("[1, 2]"), False), (content('["full", 0, 0, 9, 0, 0, 0]'), False),
        (content('["some", 0, 0, 1, 0, 0, 0]'), False), (content(UPRIGHT, index="1"), False),
        (content(UPRIGHT, stamp='"x"'), False), (content(UPRIGHT, stamp="Infinity"), False),
        ("\ufffd" * 40, False),
    ],
)
def test_file_without_a_valid_goal_is_ignored(path, text, is_valid) -> None:
    path.parent.mkdir()
    path.write_text(text, encoding="utf-8")
    assert (goal_memory(path, 30.0).recall(STAMP, True) is not None) is is_valid


VALUES = {"goal_stamp": "7.000000001", "goal_index": "1", "mode": "at the goal"}


def test_status_of_a_controller_that_has_not_planned_yet_is_read() -> None:
    report = GoalReport.of(VALUES)
    assert (report.stamp, report.index, report.plans) == ("7.000000001", 1, 0)
    assert math.isnan(report.time_left) and not report.at_rest
    more = {
        "goal_count": "2", "at_rest": "true", "plans": "3", "time_s": "4", "time_left_s": "0.5",
        "distance_left_m": "0.1", "total_time_left_s": "1.5",
        "total_distance_left_m": "0.25", "unreachable": "no way", "no_progress": "",
        "giving_up": "the goal", "path_deviation_m": "-0.02", "path_heading_error_rad": "0.3",
        "path_speed_m_s": "0.75",
    }
    assert GoalReport.of(VALUES | more) == GoalReport(
        "7.000000001", 1, 2, "at the goal", True, 3, 4.0, 0.5, 0.1, 1.5, 0.25, "no way",
        "the strategy gives up the goal", -0.02, 0.3, 0.75,
    )
    assert math.isnan(GoalReport.of(VALUES | {"distance_left_m": "1e300"}).distance_left)
    for wrong in (
        {"mode": "no goal"}, VALUES | {"plans": "many"}, VALUES | {"goal_count": "1e300"},
    ):
        with pytest.raises(InvalidInputError, match="values of controller/status"):
            GoalReport.of(wrong)


@pytest.mark.parametrize("unreachable", ["", "no way", "goal outside"])
@pytest.mark.parametrize("mode", Kind)
def test_patience_ends_in_each_mode_but_those_in_which_the_goal_is_pursued(
    mode, unreachable
) -> None:
    report = GoalReport("1.0", mode=mode.value, obstacle="why", unreachable=unreachable)
    patience = Patience(10.0)
    is_refused = unreachable == "goal outside"
    is_pursued = mode in (Kind.TRACKING, Kind.AT_GOAL, Kind.NO_GOAL) and not is_refused
    stands = mode is Kind.NO_PROGRESS and bool(unreachable)
    at_once = is_refused or mode is Kind.DISABLED or stands
    told = f"{unreachable if is_refused else mode.value}: why"
    assert patience.exhausted(report, 0.0) == (told if at_once else "")
    assert bool(patience.exhausted(report, 9.0)) is at_once
    assert bool(patience.exhausted(report, 11.0)) is not is_pursued
    patience.exhausted(GoalReport("1.0", mode=Kind.TRACKING.value), 12.0)
    assert bool(patience.exhausted(report, 13.0)) is at_once, "anew"
