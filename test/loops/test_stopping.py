# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stops on the way: the sphere stays on its path, whatever stops it, and can go on."""

import pytest
from paths import largest_distance
from sampled_loop import SampledLoop

from sphere_nmpc.conditions import Kind
from sphere_nmpc.model.state import POSE, without_momentum
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios

PERIOD = ControllerSettings().control_period
OFF = 1e-3
"""Largest distance from the path in R^6: 0.6e-3 of a stop, and 1e-4 of the integration."""
SCENARIOS = draw_scenarios(4, 55, "anywhere")


def moving(scenario: Scenario, duration: float) -> SampledLoop:
    """Return a loop that has moved for a time [s], with the states from then on."""
    loop = SampledLoop(scenario.start, goal=scenario.goal)
    loop.run(duration)
    loop.states = []
    return loop


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_sphere_stops_on_its_path_and_goes_on_when_told(scenario: Scenario) -> None:
    """Disabled and cancelled by turns, early and in the middle of a motion."""
    loop = SampledLoop(scenario.start, goal=scenario.goal)
    controller = loop.controller
    for k, after in enumerate((0.37, 0.63, 0.86)):
        loop.run(after)
        loop.states, path, time = [], loop.path(), loop.simulator.time
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
        assert not loop.simulator.plant.rotor_speeds.any()
        assert controller.is_at_rest(loop.simulator.time)
        assert largest_distance(loop.states, path) < OFF
        if cancels:
            assert not controller.cancel(), "there is nothing left to cancel"
            controller.set_goal(scenario.goal)
        controller.enabled = True
    loop.run(13.0)
    assert controller.at_goal
    assert controller.failures == 0


@pytest.mark.parametrize("scenario", SCENARIOS[:2])
def test_sphere_without_poses_stops_on_its_path(scenario: Scenario) -> None:
    loop = moving(scenario, 0.6)
    path = loop.path()
    modes = set()
    for _ in range(6):
        modes.add(loop.sample(seen=False))
        loop.advance(PERIOD)
    assert Kind.NO_FRESH_POSE in modes
    assert not loop.simulator.plant.rotor_speeds.any()
    assert largest_distance(loop.states, path) < OFF


def test_sphere_whose_controller_has_gone_stops_on_its_path() -> None:
    start = without_momentum(SCENARIOS[0].start)
    far = start[POSE].copy()
    far[:2] += 4.0
    loop = moving(Scenario(start[POSE], far, seed=1), 0.5)
    plan = loop.controller.decide(loop.simulator.time).plan.hold
    assert plan.end - loop.simulator.time > 3.5, "the command ends before the plan"
    loop.in_force, sent = plan, loop.in_force
    path = loop.path()
    loop.advance(sent.end - loop.simulator.time + 0.1)
    assert not loop.simulator.plant.rotor_speeds.any()
    assert largest_distance(loop.states, path) < OFF
