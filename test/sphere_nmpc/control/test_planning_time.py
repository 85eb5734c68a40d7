# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The wall time of a plan follows the pace of control time."""

import numpy as np
import pytest

from sphere_nmpc.control.clock_watch import ClockWatch
from sphere_nmpc.control.planning_time import MOST_LEAD, PLANNING_SHARE, PlanningTime


def after(pace: float) -> PlanningTime:
    watch = ClockWatch(simulated=True)
    for wall in np.arange(0.0, 1.0, 0.004):
        watch.read(pace * wall, 100.0 + wall)
    return PlanningTime(0.25, watch)


def on_system_clock() -> PlanningTime:
    return PlanningTime(0.25, ClockWatch(simulated=False))


@pytest.mark.parametrize("pace", [0.2, 1.0, 5.0, 50.0])
def test_budget_is_a_share_of_the_period_on_the_wall_clock(pace: float) -> None:
    planning = after(pace)
    assert planning.budget(7.0, 7.0) == pytest.approx(PLANNING_SHARE * 0.25 / pace)


def test_late_tick_has_a_smaller_budget_but_never_none() -> None:
    planning = on_system_clock()
    assert planning.budget(7.0, 7.06) == pytest.approx(PLANNING_SHARE * 0.25 - 0.06)
    assert planning.budget(7.0, 8.0) == pytest.approx(0.025)


def test_lead_follows_from_recent_durations() -> None:
    planning = on_system_clock()
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
    planning = after(5.0)
    planning.took(0.01, 0.0)
    assert planning.lead == pytest.approx(0.0625)
    planning.took(1.0, 0.0)
    assert planning.lead == MOST_LEAD * 0.25


def test_control_time_passes_with_the_wall_clock_at_the_pace() -> None:
    assert after(5.0).after(7.0, 0.01) == pytest.approx(7.05)
    assert on_system_clock().after(7.0, 0.01) == pytest.approx(7.01)
    unknown = PlanningTime(0.25, ClockWatch(simulated=True))
    assert unknown.after(7.0, 0.01) == 7.0
