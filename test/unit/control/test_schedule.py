# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The scheduler in real time, driven with plain numbers."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.schedule import (
    PLANNING_SHARE,
    LockstepSchedule,
    PlanRequest,
    Schedule,
    TimedPose,
)
from sphere_nmpc.control.timing import ClockWatch
from sphere_nmpc.settings import ControllerSettings

PERIOD = 0.5
SHARE = PLANNING_SHARE * PERIOD
STATE = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
PAPER = ControllerSettings(strategy="paper")


def pose(time: float) -> TimedPose:
    return TimedPose(round(time * 1e9), time, STATE)


def watched(pace: float, until: float) -> ClockWatch:
    """Return the watch of a simulated clock that has run for 0.6 s up to `until` [s]."""
    watch = ClockWatch(simulated=True)
    for wall in np.arange(-0.6, 0.0, 0.004):
        watch.read(until + pace * wall, wall)
    return watch


def requests(schedule: Schedule, *times: float) -> list[PlanRequest]:
    return [schedule.tick(time) for time in times]


def instants(schedule: Schedule, *times: float) -> list[float]:
    return [request.instant for request in requests(schedule, *times)]


@pytest.fixture
def schedule() -> Schedule:
    return Schedule(PAPER, ClockWatch(simulated=False))


def test_late_ticks_plan_for_their_instants_and_for_what_is_left_of_their_share(schedule) -> None:
    times, late = [1.0, 2.0, 3.5, 4.05], [0.0, 0.0, 0.0, 0.05]
    made = requests(schedule, *times)
    assert [request.instant for request in made] == pytest.approx([1.0, 2.0, 3.5, 4.0])
    assert [request.now for request in made] == times
    assert [r.time_budget for r in made] == pytest.approx([SHARE - one for one in late])
    assert schedule.missed == 3
    # A plan is made for when its command will be ready, so that no pose is newer than its plan.
    schedule.completed(0.04, solved=True)
    schedule.window = 0.1
    request = schedule.tick(4.55)
    assert request.instant == pytest.approx(4.5 + 0.05 + 0.04 + 0.1)
    assert request.time_budget == pytest.approx(SHARE - 0.05), "counted from the instant itself"


def test_pose_is_observed_when_it_arrives_or_kept_while_it_is_ahead_of_the_clock(schedule) -> None:
    now, ahead = pose(1.0), pose(3.0)
    assert schedule.pose_received(now, 1.01)
    assert not schedule.pose_received(now, None), "the clock is not known"
    assert schedule.kept is None
    assert not schedule.pose_received(ahead, 1.0)
    assert schedule.kept is ahead
    assert schedule.is_ahead(ahead, 2.4) and not schedule.is_ahead(ahead, 2.9)
    requests(schedule, 2.9)
    assert schedule.kept is None, "for one tick"
    schedule.change(ControllerSettings(strategy="paper", pose_timeout=5.0))
    assert schedule.pose_received(ahead, 1.0)


def test_goal_starts_a_new_grid_until_a_plan_towards_it_is_solved(schedule) -> None:
    assert instants(schedule, 1.0, 1.5) == pytest.approx([1.0, 1.5])
    assert schedule.may_start
    schedule.restart()
    assert instants(schedule, 1.7, 2.2, 2.7) == pytest.approx([1.7, 2.2, 2.7])
    assert schedule.missed == 0
    schedule.completed(0.0, solved=False)
    assert schedule.may_start
    schedule.completed(0.0, solved=True)
    assert not schedule.may_start
    schedule.goal_changed()
    assert schedule.may_start
    assert not Schedule(PAPER, ClockWatch(simulated=True)).may_start, "its pace is not known"


def test_jump_of_the_clock_begins_a_new_grid_and_drops_the_pose_that_was_kept(schedule) -> None:
    requests(schedule, 7.0)
    schedule.pose_received(pose(9.0), 7.0)
    schedule.completed(0.0, solved=True)
    schedule.clock_jumped(watched(5.0, until=0.3))
    assert schedule.kept is None
    (request,) = requests(schedule, 0.3)
    assert request.instant == pytest.approx(0.3)
    assert request.time_budget == pytest.approx(SHARE / 5.0), "on the clock followed now"
    assert schedule.command_time(request, 0.02) == pytest.approx(0.4)
    assert schedule.missed == 0
    assert schedule.may_start


def test_lockstep_plans_once_for_each_pose_of_a_sampling_instant() -> None:
    schedule = LockstepSchedule(PAPER, ClockWatch(simulated=True, has_pace=False))
    assert schedule.timer_period is None
    assert not schedule.pose_received(pose(0.6), None), "between two instants"
    assert schedule.pose_received(pose(0.5), None)
    assert schedule.answered == pose(0.5).stamp
    request = schedule.request(0.5)
    assert request == PlanRequest(0.5, 0.5, math.inf)
    assert schedule.command_time(request, 10.0) == 0.5
    rest = schedule.answer(request)
    assert rest.start == 0.5 and not rest.speeds.any()
    schedule.goal_changed()
    assert schedule.answered is None and not schedule.may_start
    assert "in lockstep" in str(schedule.refusal(ControllerSettings(strategy="time_optimal")))


def test_other_control_period_begins_a_new_grid_and_other_settings_keep_it(schedule) -> None:
    requests(schedule, 1.0)
    schedule.change(ControllerSettings(strategy="paper", planning_effort=2000))
    assert instants(schedule, 1.6) == pytest.approx([1.5])
    settings = ControllerSettings(strategy="time_optimal")
    assert schedule.refusal(settings) is None
    schedule.change(settings)
    assert schedule.timer_period == 0.25
    made = requests(schedule, 1.7, 1.95)
    assert [request.instant for request in made] == pytest.approx([1.7, 1.95])
    assert made[0].time_budget == pytest.approx(PLANNING_SHARE * 0.25)
    assert schedule.answer(made[0]) is None, "nothing is sent"
