# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The scheduler in real time, driven with plain numbers."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.clock_watch import ClockWatch
from sphere_nmpc.control.clocked_schedule import ClockedSchedule
from sphere_nmpc.control.planning_time import PLANNING_SHARE
from sphere_nmpc.control.schedule import NOTHING, PlanRequest, TimedPose
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import ControllerSettings

PERIOD = 0.5
SHARE = PLANNING_SHARE * PERIOD


def clocked(watch: ClockWatch | None = None, strategy: str = "paper") -> ClockedSchedule:
    return ClockedSchedule(
        ControllerSettings(strategy=strategy), watch or ClockWatch(simulated=False)
    )


def pose(time: float) -> TimedPose:
    return TimedPose(round(time * 1e9), time, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


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


def test_late_ticks_plan_for_their_instants_and_for_what_is_left_of_their_share() -> None:
    made = requests(clocked(), 1.0, 1.55, 2.0)
    assert [request.instant for request in made] == pytest.approx([1.0, 1.5, 2.0])
    assert [request.now for request in made] == [1.0, 1.55, 2.0]
    assert [r.time_budget for r in made] == pytest.approx([SHARE, SHARE - 0.05, SHARE])


def test_instants_without_a_tick_count_as_missed() -> None:
    schedule = clocked()
    requests(schedule, 1.0, 1.5, 3.0)
    assert schedule.missed == 2


@pytest.mark.parametrize("pace", [0.2, 1.0, 5.0])
def test_budget_and_time_of_command_follow_the_pace_of_simulated_time(pace: float) -> None:
    schedule = clocked(watched(pace, until=7.0))
    (request,) = requests(schedule, 7.0)
    assert request.time_budget == pytest.approx(SHARE / pace)
    assert schedule.command_time(request, 0.02) == pytest.approx(7.0 + 0.02 * pace)


def test_plan_is_made_for_when_its_command_will_be_ready() -> None:
    schedule = clocked()
    schedule.completed(0.04, solved=True)
    (request,) = requests(schedule, 1.0)
    assert request.instant == pytest.approx(1.0 + 1.25 * 0.04)
    assert request.time_budget == pytest.approx(SHARE), "counted from the instant itself"


def test_plan_after_late_ticks_is_made_for_when_its_command_will_be_ready() -> None:
    """A clock of 20 Hz is up to 50 ms late; the pose of a tick must not be newer than its plan."""
    schedule = clocked()
    requests(schedule, 1.0, 1.55)
    schedule.completed(0.04, solved=True)
    (request,) = requests(schedule, 2.05)
    assert request.instant == pytest.approx(2.0 + 1.25 * 0.09)


def test_pose_is_observed_when_it_arrives() -> None:
    schedule, now = clocked(), pose(1.0)
    assert schedule.pose_received(now, 1.01).observe is now
    assert schedule.pose_age(1.0, 1.01) == pytest.approx(0.01)


def test_pose_is_of_no_use_before_the_clock_is_known() -> None:
    schedule = clocked(ClockWatch(simulated=True))
    assert schedule.pose_received(pose(1.0), None) == NOTHING
    assert math.isnan(schedule.pose_age(1.0, None))
    assert schedule.tick(1.0).observe is None


def test_pose_ahead_of_the_clock_is_observed_at_the_next_tick() -> None:
    schedule, ahead = clocked(), pose(3.0)
    assert schedule.pose_received(ahead, 1.0) == NOTHING
    actions = schedule.tick(2.9)
    assert actions.observe is ahead and actions.refused is None
    assert actions.plan is not None
    assert schedule.tick(3.4).observe is None, "once"


def test_pose_that_is_still_ahead_at_the_next_tick_is_refused() -> None:
    schedule = clocked()
    schedule.pose_received(pose(3.0), 1.0)
    actions = schedule.tick(1.5)
    assert actions.refused == pytest.approx(1.5) and actions.observe is None
    assert actions.plan is not None, "the tick is not lost"
    assert schedule.tick(2.0).refused is None


def test_changed_pose_timeout_decides_what_is_ahead() -> None:
    schedule = clocked()
    schedule.change(ControllerSettings(strategy="paper", pose_timeout=5.0))
    assert schedule.pose_received(pose(3.0), 1.0).observe is not None


def test_goal_starts_a_new_grid_immediately() -> None:
    schedule = clocked()
    requests(schedule, 1.0, 1.5)
    schedule.goal_changed()
    actions = schedule.start(1.7, always)
    assert actions is not None and actions.plan is not None
    assert actions.plan.instant == pytest.approx(1.7)
    assert [r.instant for r in requests(schedule, 2.2, 2.7)] == pytest.approx([2.2, 2.7])
    assert schedule.missed == 0


def test_start_waits_for_a_goal_and_rotors_at_rest() -> None:
    schedule = clocked()
    assert schedule.start(1.7, lambda now: now != 1.7) is None
    assert schedule.start(1.7, lambda now: now == 1.7) is not None


def test_start_waits_until_the_pace_of_simulated_time_is_known() -> None:
    assert clocked(ClockWatch(simulated=True)).start(1.0, always) is None
    assert clocked(watched(1.0, until=1.7)).start(1.7, always) is not None


def test_only_the_first_solved_plan_towards_a_goal_starts_a_grid() -> None:
    schedule = clocked()
    schedule.completed(0.0, solved=False)
    assert schedule.start(1.0, always) is not None
    schedule.completed(0.0, solved=True)
    assert schedule.start(1.1, always) is None
    schedule.enabled()
    assert schedule.start(1.2, always) is not None


def test_restart_begins_a_new_grid_at_the_present_time() -> None:
    schedule = clocked()
    requests(schedule, 1.0)
    request = schedule.restart(1.1).plan
    assert request is not None and request.instant == pytest.approx(1.1)
    assert [r.instant for r in requests(schedule, 1.6)] == pytest.approx([1.6])
    assert schedule.missed == 0


def test_disabling_plans_immediately_and_keeps_the_grid() -> None:
    schedule = clocked()
    requests(schedule, 1.0)
    request = schedule.disabled(1.2).plan
    assert request == PlanRequest(1.2, 1.2, pytest.approx(SHARE))
    assert [r.instant for r in requests(schedule, 1.5)] == pytest.approx([1.5])
    assert schedule.disabled(None) == NOTHING


def test_jump_of_the_clock_begins_a_new_grid_and_drops_the_pose_that_was_kept() -> None:
    schedule = clocked()
    requests(schedule, 7.0)
    schedule.pose_received(pose(9.0), 7.0)
    schedule.completed(0.0, solved=True)
    schedule.clock_jumped(ClockWatch(simulated=False))
    actions = schedule.tick(0.3)
    assert actions.observe is None and actions.refused is None
    assert actions.plan is not None and actions.plan.instant == pytest.approx(0.3)
    assert schedule.missed == 0
    assert schedule.start(0.4, always) is not None


def test_budget_is_that_of_the_clock_that_is_followed_after_a_jump() -> None:
    schedule = clocked()
    schedule.clock_jumped(watched(5.0, until=7.0))
    assert schedule.tick(7.0).plan.time_budget == pytest.approx(SHARE / 5.0)
    schedule.change(ControllerSettings(strategy="time_optimal"))
    assert schedule.tick(7.0).plan.time_budget == pytest.approx(SHARE / 10.0)


@pytest.mark.parametrize("pace", [1.0, 50.0])
def test_command_begins_at_most_half_a_second_after_the_clock_that_is_known(pace: float) -> None:
    schedule = clocked(watched(pace, until=7.0))
    (request,) = requests(schedule, 7.0)
    assert schedule.command_time(request, 30.0) == 7.5


def test_other_control_period_begins_a_new_grid() -> None:
    schedule = clocked()
    requests(schedule, 1.0, 1.5)
    settings = ControllerSettings(strategy="time_optimal")
    assert schedule.refusal(settings) is None
    schedule.change(settings)
    assert schedule.timer_period == 0.25
    made = requests(schedule, 1.6, 1.85)
    assert [request.instant for request in made] == pytest.approx([1.6, 1.85])
    assert made[0].time_budget == pytest.approx(PLANNING_SHARE * 0.25)


def test_change_of_another_setting_keeps_the_grid() -> None:
    schedule = clocked()
    requests(schedule, 1.0)
    schedule.change(ControllerSettings(strategy="paper", planning_effort=2000))
    assert [r.instant for r in requests(schedule, 1.6)] == pytest.approx([1.5])


def test_nothing_is_sent_where_nothing_is_committed() -> None:
    request = PlanRequest(1.0, 1.0, 0.1)
    hold = FirstOrderHold.constant(1.0, np.zeros(2))
    assert clocked().command(request, None) is None
    assert clocked().command(request, hold) is hold
