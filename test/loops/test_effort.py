# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time against effort: `time_margin` and `arrive_at` in closed loops, and the effort counted."""

from dataclasses import replace

import numpy as np
import pytest
from floor_plans import DOORWAY, RADIUS, floor_of, least_distance, pose
from sampled_loop import ROBOT, SampledLoop

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.control.status import ControllerStatus
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import POSITION, Vector, upright_state
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.scenario.scenarios import PAPER_CASES

pytestmark = pytest.mark.slow

PLAIN = ControllerSettings(control_rate=20.0)
SPARING = replace(PLAIN, time_margin=0.1)
CASE = PAPER_CASES[1]
BEYOND = upright_state(16.0, 3.0, 1.0)
"""A goal so far away that whole turns of steady rolling lead to it."""


def run(
    settings: ControllerSettings, start: Vector = CASE.start, goal: Vector = CASE.goal,
    duration: float = 12.0, **others: object,
) -> SampledLoop:
    loop = SampledLoop(start, settings, goal=goal, **others)
    loop.run(duration)
    loop.check_limits()
    assert loop.controller.failures == 0, loop.controller.last_failure
    return loop


def heat(loop: SampledLoop) -> float:
    times, speeds = np.array(loop.times), np.array(loop.speeds)
    kept = np.append(True, np.diff(times) > 0.0)
    times, speeds = times[kept], speeds[kept]
    return float(np.sum(np.diff(speeds, axis=0) ** 2 / np.diff(times)[:, None]))


@pytest.mark.parametrize("search_time", [None, 0.06])
@pytest.mark.parametrize(
    ("goal", "steady"), [(CASE.goal, 0.0), (BEYOND, 16.0)], ids=["near", "far"]
)
def test_margin_spares_the_motors_and_is_spent_once(
    goal: Vector, steady: float, search_time: float | None
) -> None:
    fast, spared = (
        run(settings, goal=goal, duration=12.0 + 1.2 * steady, search_time=search_time)
        for settings in (PLAIN, SPARING)
    )
    assert spared.settled() < 1.13 * fast.settled()
    assert spared.settled() > fast.settled() + 0.05 * (fast.settled() - steady)
    assert heat(spared) < 0.55 * heat(fast)
    arrivals = [plan.arrival for plan in spared.plans if plan.spared]
    assert max(arrivals) < arrivals[0] + 0.02


@pytest.mark.parametrize("search_time", [None, 0.06])
def test_arrival_is_at_the_time_asked_for_each_leg(search_time: float | None) -> None:
    loop = SampledLoop(CASE.start, replace(PLAIN, arrive_at=8.0), search_time=search_time)
    course = Course.of(Goal(CASE.goal), Goal(CASE.start))
    loop.controller.following.take(ActiveCourse(course, 1))
    loop.run(7.7)
    assert loop.decision.plan.arrival == pytest.approx(8.0, abs=0.02)
    loop.run(5.0)
    assert loop.decision.plan.arrival == pytest.approx(16.0, abs=0.05)


def test_time_that_is_less_than_the_least_is_told_and_the_motion_as_without() -> None:
    fast, asked = (run(replace(PLAIN, arrive_at=time), duration=3.0) for time in (0.0, 2.0))
    assert np.array_equal(fast.states, asked.states)
    assert "later than asked" in asked.decision.plan.message
    assert not asked.given_up


def test_margin_that_changes_is_that_of_the_next_goal() -> None:
    loop = run(PLAIN, duration=2.0)
    arrival = loop.decision.plan.arrival
    loop.controller.change(replace(PLAIN, time_margin=0.5))
    loop.run(10.0)
    assert loop.settled() < arrival + 0.1
    began = loop.time
    loop.controller.set_goal(CASE.start)
    loop.run(1.0)
    assert loop.decision.plan.arrival - began > 1.3 * arrival


def test_floor_is_kept_clear_of_with_less_heat() -> None:
    floor, start, goal = floor_of(DOORWAY), pose(1.0, 2.0), pose(5.0, 2.2)
    fast, spared = (
        run(replace(PLAIN, time_margin=margin, planning_effort=20_000), start, goal, 14.0,
            floor=floor) for margin in (0.0, 0.2)
    )
    assert spared.error() < 1e-2 and spared.settled() < 1.3 * fast.settled()
    assert least_distance(floor, np.array(spared.states)[::4, POSITION]) >= RADIUS
    assert heat(spared) < 0.8 * heat(fast)


def test_goal_is_reached_with_momentum() -> None:
    loop = SampledLoop(CASE.start, replace(PLAIN, time_margin=0.3), goal=CASE.goal, is_known=True)
    loop.push_momentum(np.array([30.0, -20.0, 0.0]))
    loop.run(15.0)
    assert loop.error() < 2e-2
    loop.check_limits()


def test_heat_and_energy_of_the_status_are_those_of_the_plant() -> None:
    loop, true = SampledLoop(CASE.start, PLAIN, goal=CASE.goal), np.zeros(2)
    status = ControllerStatus(loop.controller, ROBOT, PLAIN)
    for _ in range(81):
        loop.sample()
        values = status.values(loop.decision, loop.time, 0.0, 0)
        counted = [values["heat"], values["energy_j"]]
        before = true.copy()
        for _ in range(10):
            loop.advance(0.005)
            torque, speed = loop.plant.rotor_torques, loop.plant.rotor_speeds
            true += 0.005 * np.array((torque @ torque, np.abs(torque * speed).sum()))
    np.testing.assert_allclose(counted, before, rtol=0.05)
    loop.controller.set_goal(CASE.start)
    assert status.values(loop.decision, loop.time, 0.0, 0)["heat"] == values["heat"]
    loop.run(0.5)
    assert 0.0 < status.values(loop.decision, loop.time, 0.0, 0)["heat"] < values["heat"]
