# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans are kept while nothing is new, and the sphere stops on their path whatever stops it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from floor_plans import RADIUS
from motions import largest_distance
from sampled_loop import SampledLoop, check_hold

from sphere_nmpc.control.sending import REACH
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import POSITION, QUATERNION, as_state
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios

OFF = 1e-3
"""Largest distance from the path in R^6: 0.6e-3 of a stop, and 1e-4 of the integration."""
SCENARIOS = draw_scenarios(4, 55, "anywhere")
PERIOD = 0.02
RATE_50 = ControllerSettings(control_rate=1.0 / PERIOD)


def moving(start: np.ndarray, goal: np.ndarray, duration: float) -> SampledLoop:
    """Return a loop that has moved for a time [s], with the states from then on."""
    loop = SampledLoop(start, goal=goal)
    loop.run(duration)
    loop.keep_from_now_on()
    return loop


def has_stopped_on(loop: SampledLoop, path: np.ndarray) -> bool:
    """Return whether the rotors rest, and the sphere was on a path all the time."""
    return not loop.plant.rotor_speeds.any() and largest_distance(loop.states, path) < OFF


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_sphere_stops_on_its_path_and_goes_on_when_told(scenario: Scenario) -> None:
    """Disabled and cancelled by turns, early and in the middle of a motion."""
    loop = SampledLoop(scenario.start, goal=scenario.goal)
    controller = loop.controller
    for k, after in enumerate((0.37, 0.63, 0.86)):
        loop.run(after)
        loop.keep_from_now_on()
        path, time = loop.path(), loop.time
        cancels = (k + SCENARIOS.index(scenario)) % 2 == 1
        if cancels:
            assert controller.cancel()
        else:
            controller.enabled = False
        stopped = Kind.NO_GOAL if cancels else Kind.DISABLED
        assert loop.sample() is stopped
        assert loop.in_force.end - time < 0.5
        loop.advance(0.1)
        assert loop.sample() is stopped, "a second command of the stop changes nothing"
        loop.advance(0.5)
        assert has_stopped_on(loop, path)
        assert controller.is_at_rest(loop.time)
        if cancels:
            assert not controller.cancel(), "there is nothing left to cancel"
            controller.set_goal(scenario.goal)
        controller.enabled = True
    loop.run(13.0)
    assert controller.at_goal
    assert controller.failures == 0


@pytest.mark.parametrize("scenario", SCENARIOS[:2])
def test_sphere_without_poses_stops_on_its_path(scenario: Scenario) -> None:
    loop = moving(scenario.start, scenario.goal, 0.6)
    path, modes = loop.path(), set()
    for _ in range(6):
        modes.add(loop.sample(seen=False))
        loop.advance(loop.settings.control_period)
    assert Kind.NO_FRESH_POSE in modes
    assert has_stopped_on(loop, path)


def test_sphere_whose_controller_has_gone_stops_on_its_path() -> None:
    start = SCENARIOS[0].start
    loop = moving(start, np.append(start[POSITION] + 4.0, start[QUATERNION]), 0.5)
    plan = loop.controller.decide(loop.time).plan.hold
    assert plan.end - loop.time > 3.5, "the command ends before the plan"
    loop.in_force, sent = plan, loop.in_force
    path = loop.path()
    loop.advance(sent.end - loop.time + 0.1)
    assert has_stopped_on(loop, path)


@pytest.fixture
def kept() -> SampledLoop:
    """A loop at 50 Hz whose newest plan has been kept."""
    start = as_state([2.0, -3.0, 0.03, 0.454, 0.88, 0.1363])
    loop = SampledLoop(start, RATE_50, goal=as_state([0, 0, 1, 0, 0, 0]))
    while not loop.decisions or loop.decision.is_new:
        loop.run(PERIOD)
    return loop


def test_plan_is_kept_at_most_instants_and_the_sphere_arrives_and_rests(kept: SampledLoop) -> None:
    assert kept.decision.plan.made.solve_time > 0.0
    assert kept.decision.solve_time == 0.0, "it counts once"
    kept.run(7.2 - kept.time)
    assert kept.controller.at_goal
    is_new = [decision.is_new for decision in kept.decisions]
    assert np.mean(is_new) < 0.35  # a prototype solved a third
    assert np.mean(is_new[-25:]) < 0.2  # at rest as well, once a sample period and a little
    assert kept.controller.failures == 0


def another_goal(loop: SampledLoop) -> None:
    loop.controller.set_goal(Goal(as_state([0.01, 0, 1, 0, 0, 0])))


def floor_in_the_way(loop: SampledLoop) -> None:
    occupied = np.ones((400, 400), dtype=bool)
    loop.controller.floor = Floor(Grid(occupied, 0.05, (-10.0, -10.0, 0.0)), RADIUS, 0.05)


def shift(loop: SampledLoop) -> None:
    loop.plant.displace(loop.pose + 1e-4 * np.eye(6)[0])


def another_weight(loop: SampledLoop) -> None:
    loop.controller.change(replace(RATE_50, planning_effort=20_000))


def pause(loop: SampledLoop) -> None:
    loop.controller.enabled = False
    loop.run(PERIOD)
    loop.controller.enabled = True


@pytest.mark.parametrize("event", [another_goal, floor_in_the_way, shift, another_weight, pause])
def test_what_is_new_leads_to_another_plan(
    kept: SampledLoop, event: Callable[[SampledLoop], None]
) -> None:
    plan = kept.decision.plan
    event(kept)
    kept.run(PERIOD)
    assert kept.decision.is_new
    assert kept.decision.plan is not plan


def test_what_is_sent_of_a_plan_that_is_kept_is_its_rest(kept: SampledLoop) -> None:
    before, plan = kept.in_force, kept.decision.plan
    kept.run(PERIOD)
    assert kept.decision.plan is plan
    sent = kept.in_force
    assert sent.start == pytest.approx(kept.time - PERIOD, abs=1e-9)
    assert before.end == sent.end <= sent.start + REACH + 1.0
    for time in np.linspace(sent.start, sent.end, 50):
        np.testing.assert_allclose(sent.at(float(time)), before.at(float(time)), atol=1e-9)
    # Stamps are whole nanoseconds, the shortest interval is a thousand of them.
    check_hold(sent, slack=1e-6)
