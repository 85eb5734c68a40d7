# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stops on the way: disabled, without poses or without commands the sphere stays on its path."""

from dataclasses import dataclass, field

import pytest
from paths import largest_distance, moved

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Mode
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, without_momentum
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
SETTINGS = ControllerSettings()
PERIOD = SETTINGS.control_period
SPACING = 5e-3
"""Spacing of the poses that are compared [s]."""
OFF = 1e-3
"""Largest distance from the path in R^6: 0.6e-3 of a stop, and 1e-4 of the integration."""
SCENARIOS = draw_scenarios(4, 55, "anywhere")


@dataclass
class Loop:
    """Closed loop that can be interrupted between sampling instants."""

    scenario: Scenario
    controller: Controller = field(init=False)
    simulator: Simulator = field(init=False)
    in_force: FirstOrderHold = field(init=False)
    states: list[Vector] = field(default_factory=list)

    def __post_init__(self) -> None:
        start = self.scenario.start
        self.controller = Controller(SETTINGS, ROBOT)
        self.simulator = Simulator(
            SimulatorSettings(initial_state=tuple(start)), ROBOT,
            make_plant("rolling", ROBOT, start),
        )
        self.controller.set_goal(self.scenario.goal)

    def sample(self, seen: bool = True) -> Mode:
        """Let the controller decide for now; `seen` says whether it gets a pose."""
        now = self.simulator.time
        if seen:
            self.controller.observe(now, self.simulator.measured_state())
        decision = self.controller.decide(now)
        hold = self.controller.commit(decision, now)
        if hold is not None:
            self.in_force = hold
            self.simulator.follower.follow_trajectory(hold)
        return decision.mode

    def advance(self, duration: float) -> None:
        """Let time pass, and keep the states."""
        end = self.simulator.now + round(duration * NANOSECONDS)
        while self.simulator.now < end:
            self.states.append(self.simulator.plant.state[POSE])
            self.simulator.advance_to(min(end, self.simulator.now + round(SPACING * NANOSECONDS)))
        self.states.append(self.simulator.plant.state[POSE])

    def run(self, duration: float) -> None:
        """Sample until a time that need not be an instant [s]."""
        end = self.simulator.time + duration
        while self.simulator.time < end - 1e-9:
            self.sample()
            self.advance(min(PERIOD, end - self.simulator.time))

    def path(self) -> Vector:
        """Return the path of the hold in force from now on, at poses 1 mm apart."""
        now = self.simulator.time
        rest = self.in_force.starting_at(now, self.in_force.at(now))
        state = without_momentum(self.simulator.plant.state[POSE])
        return moved(state, rest, now, rest.end, 1e-3)[:, POSE]


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("time", [0.37, 1.0, 1.86])
def test_disabled_sphere_stops_on_its_path_and_goes_on_when_enabled(
    scenario: Scenario, time: float
) -> None:
    loop = Loop(scenario)
    loop.run(time)
    path, loop.states = loop.path(), []
    loop.controller.enabled = False
    assert loop.sample() is Mode.DISABLED
    assert loop.in_force.end - time < 0.5
    loop.advance(0.1)
    assert loop.sample() is Mode.DISABLED, "a second command of the stop changes nothing"
    loop.advance(0.5)
    assert not loop.simulator.plant.rotor_speeds.any()
    assert largest_distance(loop.states, path) < OFF
    loop.controller.enabled = True
    loop.run(13.0)
    assert loop.controller.at_goal
    assert loop.controller.failures == 0


@pytest.mark.parametrize("scenario", SCENARIOS[:2])
def test_sphere_without_poses_stops_on_its_path(scenario: Scenario) -> None:
    loop = Loop(scenario)
    loop.run(0.6)
    path, loop.states = loop.path(), []
    modes = set()
    for _ in range(6):
        modes.add(loop.sample(seen=False))
        loop.advance(PERIOD)
    assert Mode.NO_FRESH_POSE in modes
    assert not loop.simulator.plant.rotor_speeds.any()
    assert largest_distance(loop.states, path) < OFF


def test_sphere_whose_controller_has_gone_stops_on_its_path() -> None:
    start = without_momentum(SCENARIOS[0].start)
    far = start[POSE].copy()
    far[:2] += 4.0
    loop = Loop(Scenario(start[POSE], far, seed=1))
    loop.run(0.5)
    plan = loop.controller.decide(loop.simulator.time).plan.hold
    assert plan.end - loop.simulator.time > 3.5, "the command ends before the plan"
    loop.in_force, sent = plan, loop.in_force
    path, loop.states = loop.path(), []
    loop.advance(sent.end - loop.simulator.time + 0.1)
    assert not loop.simulator.plant.rotor_speeds.any()
    assert largest_distance(loop.states, path) < OFF
