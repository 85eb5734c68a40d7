# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A plan that is kept while nothing is new: when it is, when it is not, and what is sent of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sampled_loop import ROBOT, SampledLoop

from sphere_nmpc.control.link import REACH
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import as_state
from sphere_nmpc.settings import ControllerSettings

GOAL = as_state([0, 0, 1, 0, 0, 0])
START = as_state([2.0, -3.0, 0.03, 0.454, 0.88, 0.1363])
PERIOD = 0.02


SETTINGS = ControllerSettings(control_rate=1.0 / PERIOD)


def kept() -> SampledLoop:
    """Return a loop that is as the controller knows it, at 50 Hz."""
    return SampledLoop(START, SETTINGS, goal=GOAL)


def test_plan_is_kept_at_most_instants_and_the_sphere_arrives_and_rests() -> None:
    loop = kept()
    loop.run(360 * PERIOD)
    assert loop.controller.at_goal
    assert np.mean(loop.is_new) < 0.35  # a prototype solved a third
    assert np.mean(loop.is_new[-25:]) < 0.2  # at rest as well, once a sample period and a little
    assert loop.controller.failures == 0


@pytest.fixture
def following() -> SampledLoop:
    """A loop whose newest plan has been kept."""
    loop = kept()
    while not loop.is_new or loop.is_new[-1]:
        loop.run(PERIOD)
    return loop


def another_goal(loop: SampledLoop) -> None:
    loop.controller.set_goal(Goal(as_state([0.01, 0, 1, 0, 0, 0])))


def floor(loop: SampledLoop) -> None:
    free = np.zeros((400, 400), dtype=bool)
    loop.controller.floor = Floor(Grid(free, 0.05, (-10.0, -10.0, 0.0)), ROBOT.shell_radius, 0.05)


def shift(loop: SampledLoop) -> None:
    moved = loop.pose.copy()
    moved[0] += 1e-4
    loop.simulator.plant.displace(moved)


def another_weight(loop: SampledLoop) -> None:
    loop.controller.change(replace(SETTINGS, planning_effort=20_000))


def pause(loop: SampledLoop) -> None:
    loop.controller.enabled = False
    loop.run(PERIOD)
    loop.controller.enabled = True


@pytest.mark.parametrize("event", [another_goal, floor, shift, another_weight, pause])
def test_what_is_new_leads_to_another_plan(
    following: SampledLoop, event: Callable[[SampledLoop], None]
) -> None:
    plan = following.decision.plan
    event(following)
    following.run(PERIOD)
    assert following.decision.is_new
    assert following.decision.plan is not plan


def test_what_is_sent_of_a_plan_that_is_kept_is_its_rest(following: SampledLoop) -> None:
    before, plan = following.in_force, following.decision.plan
    following.run(PERIOD)
    assert following.decision.plan is plan
    sent = following.in_force
    assert sent.start == pytest.approx(following.simulator.time - PERIOD, abs=1e-9)
    assert before.end == sent.end <= sent.start + REACH + 1.0
    for time in np.linspace(sent.start, sent.end, 50):
        np.testing.assert_allclose(sent.at(float(time)), before.at(float(time)), atol=1e-9)
    slopes = np.abs(np.diff(sent.speeds, axis=0)) / np.diff(sent.times)[:, None]
    # Stamps are whole nanoseconds, the shortest interval is a thousand of them.
    assert np.max(slopes) <= ROBOT.max_rotor_acceleration * (1.0 + 1e-6)


def test_wall_time_of_a_plan_counts_once(following: SampledLoop) -> None:
    assert following.decision.plan.solve_time > 0.0
    assert following.decision.solve_time == 0.0
