# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The wall time of a plan follows the pace of control time."""

import numpy as np
import pytest

from sphere_nmpc.control.planning_time import MOST_LEAD, PLANNING_SHARE, PlanningTime


def after(pace: float, duration: float, start: float = 0.0) -> PlanningTime:
    planning = PlanningTime(0.25, simulated=True)
    for wall in np.arange(0.0, duration, 0.004):
        planning.read(start + pace * wall, 100.0 + wall)
    return planning


@pytest.mark.parametrize("pace", [0.2, 1.0, 5.0, 50.0])
def test_budget_is_a_share_of_the_period_on_the_wall_clock(pace: float) -> None:
    planning = after(pace, 2.0)
    assert planning.pace == pytest.approx(pace)
    assert planning.budget(7.0, 7.0) == pytest.approx(PLANNING_SHARE * 0.25 / pace)


def test_late_tick_has_a_smaller_budget_but_never_none() -> None:
    planning = PlanningTime(0.25, simulated=False)
    assert planning.pace == 1.0
    assert planning.budget(7.0, 7.06) == pytest.approx(PLANNING_SHARE * 0.25 - 0.06)
    assert planning.budget(7.0, 8.0) == pytest.approx(0.025)


def test_pace_is_unknown_until_it_has_been_measured_for_a_while() -> None:
    assert PlanningTime(0.25, simulated=True).pace is None
    assert after(5.0, 0.009).pace is None
    assert after(5.0, 0.03).pace == pytest.approx(5.0)


def test_new_pace_is_known_half_a_second_later() -> None:
    planning = after(1.0, 2.0)
    for wall in np.arange(0.0, 0.6, 0.004):
        planning.read(2.0 + 4.0 * wall, 102.0 + wall)
    assert planning.pace == pytest.approx(4.0, rel=0.01)


def test_pause_and_a_jump_back_are_no_pace() -> None:
    planning = after(5.0, 1.0)
    for wall in (101.2, 101.4, 101.6):
        planning.read(5.0, wall)
    assert planning.pace is None
    planning.read(5.1, 101.62)
    assert planning.pace is None, "how long before the reading time went on is unknown"
    planning.read(5.2, 101.64)
    assert planning.pace == pytest.approx(5.0)
    planning.read(0.0, 101.7)
    assert planning.pace is None


def test_pace_is_not_overestimated_where_a_pose_is_handled_before_the_clock() -> None:
    """A process held up for 0.4 s reads the clock as it was, and then 0.8 s later at once."""
    planning = after(2.0, 2.0)
    held_up, now = 102.4, 4.8
    planning.read(4.0, 102.0)
    planning.read(4.0, held_up)
    for wall in np.arange(0.0, 0.1, 0.02):
        planning.read(now + 2.0 * wall, held_up + 0.001 + wall)
        assert planning.pace in (None, pytest.approx(2.0))


def test_second_reading_of_the_same_instant_counts_for_nothing() -> None:
    planning = after(1.0, 1.0)
    pace = planning.pace
    planning.read(0.996, 101.05)
    assert planning.pace == pace


def test_lead_follows_from_recent_durations() -> None:
    planning = PlanningTime(0.25, simulated=False)
    assert planning.lead == 0.0
    planning.took(1.0, 0.0)
    assert planning.lead == pytest.approx(MOST_LEAD * 0.25)
    for _ in range(8):
        planning.took(0.02, 0.0)
    assert planning.lead == pytest.approx(0.025)
    for _ in range(8):
        planning.took(0.001, 0.0)
    assert planning.lead == 0.0, "a negligible duration"


def test_lead_is_in_control_time_and_never_more_than_the_share() -> None:
    planning = after(5.0, 1.0)
    planning.took(0.01, 0.0)
    assert planning.lead == pytest.approx(0.0625)
    planning.took(1.0, 0.0)
    assert planning.lead == MOST_LEAD * 0.25


def test_control_time_passes_with_the_wall_clock_at_the_pace() -> None:
    assert after(5.0, 1.0).after(7.0, 0.01) == pytest.approx(7.05)
    assert PlanningTime(0.25, simulated=False).after(7.0, 0.01) == pytest.approx(7.01)
    assert PlanningTime(0.25, simulated=True).after(7.0, 0.01) == 7.0, "the pace is unknown"
