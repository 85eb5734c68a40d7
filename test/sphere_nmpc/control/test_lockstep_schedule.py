# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The scheduler in lockstep, driven with plain numbers."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.clock_watch import ClockWatch
from sphere_nmpc.control.lockstep_schedule import LockstepSchedule
from sphere_nmpc.control.schedule import NOTHING, Actions, PlanRequest, TimedPose
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import ControllerSettings

PAPER = ControllerSettings(strategy="paper")
MS = 1_000_000


@pytest.fixture
def schedule() -> LockstepSchedule:
    return LockstepSchedule(PAPER)


def receive(schedule: LockstepSchedule, stamp: int, now: float | None = None) -> Actions:
    """Let the pose of `stamp` [ms] arrive."""
    state = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return schedule.pose_received(TimedPose(stamp * MS, stamp / 1e3, state), now)


def test_pose_of_a_sample_instant_is_observed_and_planned_from_without_a_time_limit(
    schedule: LockstepSchedule,
) -> None:
    actions = receive(schedule, 1500)
    assert actions.observe is not None and actions.observe.time == 1.5
    assert actions.plan == PlanRequest(1.5, 1.5, math.inf)


def test_pose_between_sample_instants_is_not_observed(schedule: LockstepSchedule) -> None:
    assert receive(schedule, 1510) == NOTHING


@pytest.mark.parametrize("now", [None, 0.0, 99.0])
def test_clock_of_the_node_is_ignored(schedule: LockstepSchedule, now) -> None:
    actions = receive(schedule, 1500, now)
    assert actions.plan is not None and actions.plan.instant == 1.5
    assert math.isnan(schedule.pose_age(1.5, now))


def test_repeated_instant_gets_the_same_command_again(schedule: LockstepSchedule) -> None:
    receive(schedule, 500)
    assert receive(schedule, 500) == Actions(repeat=True)
    assert receive(schedule, 1000).plan is not None


@pytest.mark.parametrize(
    "event",
    [LockstepSchedule.goal_changed, lambda it: it.clock_jumped(ClockWatch(simulated=True))],
)
def test_repeated_instant_is_planned_again_after(schedule: LockstepSchedule, event) -> None:
    receive(schedule, 500)
    event(schedule)
    actions = receive(schedule, 500)
    assert actions.plan is not None and not actions.repeat


def test_enabling_and_disabling_wait_for_the_next_instant(schedule: LockstepSchedule) -> None:
    receive(schedule, 500)
    schedule.enabled()
    assert schedule.disabled(0.5) == NOTHING
    assert receive(schedule, 500) == Actions(repeat=True)


def test_neither_time_nor_a_goal_triggers_a_plan(schedule: LockstepSchedule) -> None:
    assert schedule.timer_period is None
    assert schedule.tick(0.5) == NOTHING
    assert schedule.start(0.5, lambda now: True) is None


def test_command_is_dated_at_its_instant_however_long_the_plan_took(
    schedule: LockstepSchedule,
) -> None:
    assert schedule.command_time(PlanRequest(1.5, 1.5, math.inf), elapsed=3.0) == 1.5


def test_rest_is_the_answer_where_nothing_is_committed(schedule: LockstepSchedule) -> None:
    request = PlanRequest(1.5, 1.5, math.inf)
    answer = schedule.command(request, None)
    assert answer is not None and answer.start == 1.5 and not answer.speeds.any()
    hold = FirstOrderHold.constant(1.5, np.ones(2))
    assert schedule.command(request, hold) is hold


def test_last_plan_is_for_the_present(schedule: LockstepSchedule) -> None:
    assert schedule.final_request(0.7) == PlanRequest(0.7, 0.7, math.inf)


def test_only_a_change_to_another_control_period_is_refused(schedule: LockstepSchedule) -> None:
    same = ControllerSettings(strategy="plan_keeping")
    assert schedule.refusal(same) is None
    schedule.change(same)
    reason = schedule.refusal(ControllerSettings(strategy="time_optimal"))
    assert reason is not None and "every 0.5 s" in reason
