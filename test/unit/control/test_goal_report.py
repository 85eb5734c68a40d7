# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What a status says about the goals, and when one of them is given up."""

import math

import pytest

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.goal_report import GoalReport, Patience
from sphere_nmpc.errors import InvalidInputError

VALUES = {"goal_stamp": "7.000000001", "goal_index": "1", "mode": "at the goal"}


def test_status_of_a_controller_that_has_not_planned_yet_is_read() -> None:
    report = GoalReport.of(VALUES)
    assert (report.stamp, report.index, report.plans) == ("7.000000001", 1, 0)
    assert math.isnan(report.time_left) and not report.at_rest
    more = {
        "goal_count": "2", "at_rest": "true", "plans": "3", "time_s": "4", "time_left_s": "0.5",
        "distance_left_m": "0.1", "total_time_left_s": "1.5",
        "total_distance_left_m": "0.25", "unreachable": "no way", "no_progress": "",
        "giving_up": "the goal",
    }
    assert GoalReport.of(VALUES | more) == GoalReport(
        "7.000000001", 1, 2, "at the goal", True, 3, 4.0, 0.5, 0.1, 1.5, 0.25, "no way",
        "the goal",
    )
    assert math.isnan(GoalReport.of(VALUES | {"distance_left_m": "1e300"}).distance_left)
    for wrong in (
        {"mode": "no goal"}, VALUES | {"plans": "many"}, VALUES | {"goal_count": "1e300"},
    ):
        with pytest.raises(InvalidInputError, match="values of controller/status"):
            GoalReport.of(wrong)


@pytest.mark.parametrize("mode", Kind)
def test_patience_ends_in_each_mode_but_those_in_which_the_goal_is_pursued(mode) -> None:
    patience, report = Patience(10.0), GoalReport("1.0", mode=mode.value, obstacle="why")
    is_pursued = mode in (Kind.TRACKING, Kind.AT_GOAL, Kind.NO_GOAL)
    at_once = patience.exhausted(report, 0.0)
    assert at_once == ("disabled: why" if mode is Kind.DISABLED else "")
    assert bool(patience.exhausted(report, 9.0)) is (mode is Kind.DISABLED)
    assert bool(patience.exhausted(report, 11.0)) is not is_pursued
    patience.exhausted(GoalReport("1.0", mode=Kind.TRACKING.value), 12.0)
    assert bool(patience.exhausted(report, 13.0)) is (mode is Kind.DISABLED), "anew"


def test_unreachable_goal_is_given_up_once_the_sphere_stands() -> None:
    for mode, is_over in ((Kind.TRACKING, False), (Kind.NO_PROGRESS, True)):
        report = GoalReport("1.0", mode=mode.value, unreachable="goal outside")
        assert bool(Patience(10.0).exhausted(report, 0.0)) is is_over
