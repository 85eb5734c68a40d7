# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The scheduler in real time, driven with plain numbers."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.schedule import (
    NOTHING,
    PLANNING_SHARE,
    ClockedSchedule,
    PlanRequest,
    TimedPose,
)
from sphere_nmpc.control.timing import ClockWatch
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import ControllerSettings

PERIOD = 0.5
SHARE = PLANNING_SHARE * PERIOD
STATE = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
PAPER = ControllerSettings(strategy="paper")
HOLD = FirstOrderHold.constant(1.0, np.ones(2))


def pose(time: float) -> TimedPose:
    return TimedPose(round(time * 1e9), time, STATE)


def watched(pace: float, until: float) -> ClockWatch:
    """Return the watch of a simulated clock that has run for 0.6 s up to `until` [s]."""
    watch = ClockWatch(simulated=True)
    for wall in np.arange(-0.6, 0.0, 0.004):
        watch.read(until + pace * wall, wall)
    return watch


def always(_: float) -> bool:
    return True


def requests(schedule: ClockedSchedule, *times: float) -> list[PlanRequest]:
    made = [schedule.tick(time).plan for time in times]
    return [request for request in made if request is not None]


def instants(schedule: ClockedSchedule, *times: float) -> list[float]:
    return [request.instant for request in requests(schedule, *times)]


@pytest.fixture
def schedule() -> ClockedSchedule:
    return ClockedSchedule(PAPER, ClockWatch(simulated=False))


def test_late_ticks_plan_for_their_instants_and_for_what_is_left_of_their_share(schedule) -> None:
    made = requests(schedule, 1.0, 1.55, 2.0, 3.5)
    assert [request.instant for request in made] == pytest.approx([1.0, 1.5, 2.0, 3.5])
    assert [request.now for request in made] == [1.0, 1.55, 2.0, 3.5]
    assert [r.time_budget for r in made] == pytest.approx([SHARE, SHARE - 0.05, SHARE, SHARE])
    assert schedule.missed == 2


def test_plan_is_made_for_when_its_command_will_be_ready(schedule) -> None:
    """A clock of 20 Hz is up to 50 ms late; the pose of a tick must not be newer than its plan."""
    requests(schedule, 1.0, 1.55)
    schedule.completed(0.04, solved=True)
    schedule.window = 0.1
    (request,) = requests(schedule, 2.05)
    assert request.instant == pytest.approx(2.0 + 0.09 + 0.1)
    assert request.time_budget == pytest.approx(SHARE - 0.05), "counted from the instant itself"


def test_pose_is_observed_when_it_arrives_or_refused_while_it_is_ahead_of_the_clock(
    schedule,
) -> None:
    now, ahead = pose(1.0), pose(3.0)
    assert schedule.pose_received(now, 1.01).observe is now
    assert schedule.pose_age(1.0, 1.01) == pytest.approx(0.01)
    assert schedule.pose_received(now, None) == NOTHING, "the clock is not known"
    assert math.isnan(schedule.pose_age(1.0, None))
    assert schedule.pose_received(ahead, 1.0) == NOTHING
    actions = schedule.tick(2.9)
    assert actions.observe is ahead and actions.refused is None
    assert actions.plan is not None
    assert schedule.tick(3.4).observe is None, "once"
    schedule.pose_received(pose(6.0), 3.5)
    actions = schedule.tick(4.5)
    assert actions.refused == pytest.approx(1.5) and actions.observe is None
    assert actions.plan is not None, "the tick is not lost"
    assert schedule.tick(5.0).refused is None
    schedule.change(ControllerSettings(strategy="paper", pose_timeout=5.0))
    assert schedule.pose_received(ahead, 1.0).observe is ahead


def test_goal_starts_a_new_grid_until_a_plan_towards_it_is_solved(schedule) -> None:
    assert instants(schedule, 1.0, 1.5) == pytest.approx([1.0, 1.5])
    assert schedule.start(1.7, lambda now: now != 1.7) is None, "no goal, or not at rest"
    actions = schedule.start(1.7, lambda now: now == 1.7)
    assert actions is not None and actions.plan is not None
    assert actions.plan.instant == pytest.approx(1.7)
    assert instants(schedule, 2.2, 2.7) == pytest.approx([2.2, 2.7])
    assert schedule.missed == 0
    schedule.completed(0.0, solved=False)
    assert schedule.start(3.0, always) is not None
    schedule.completed(0.0, solved=True)
    assert schedule.start(3.1, always) is None
    for event in (schedule.enabled, schedule.goal_changed):
        event()
        assert schedule.start(3.2, always) is not None
        schedule.completed(0.0, solved=True)


def test_jump_of_the_clock_begins_a_new_grid_and_drops_the_pose_that_was_kept(schedule) -> None:
    requests(schedule, 7.0)
    schedule.pose_received(pose(9.0), 7.0)
    schedule.completed(0.0, solved=True)
    schedule.clock_jumped(watched(5.0, until=0.3))
    actions = schedule.tick(0.3)
    assert actions.observe is None and actions.refused is None
    assert actions.plan is not None and actions.plan.instant == pytest.approx(0.3)
    assert actions.plan.time_budget == pytest.approx(SHARE / 5.0), "on the clock followed now"
    assert schedule.command_time(actions.plan, 0.02) == pytest.approx(0.4)
    assert schedule.missed == 0
    assert schedule.start(0.4, always) is not None


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
    assert schedule.command(made[0], None) is None
    assert schedule.command(made[0], HOLD) is HOLD
