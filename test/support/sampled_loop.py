# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop of a controller and the simulator that can be interrupted at any time.

Made with a plant, a controller's settings or strategy, a floor and a worker; events come between
two calls of `SampledLoop.run`, and rules are checked on what it keeps.
"""

from dataclasses import dataclass, field

import numpy as np
from delayed_worker import DelayedWorker
from paths import moved

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, POSITION, Vector, without_momentum
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Strategy
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
_SPACING = 5e-3
"""Spacing of the states that are kept [s]."""


@dataclass
class SampledLoop:
    """Closed loop of an ideal sphere from rest at `start`, shape (6,), on.

    The sphere is that of `plant`, which the controller knows as `ROBOT`; each command is sent
    `delay` [s] after the instant that it was planned for. A worker answers a search after
    `search_time` [s]; without, it is searched in line. `strategy` replaces that of the settings.
    """

    start: Vector
    settings: ControllerSettings = field(default_factory=ControllerSettings)
    plant: RobotParameters = ROBOT
    delay: float = 0.0
    floor: Floor | None = None
    goal: Vector | None = None
    strategy: Strategy | None = None
    search_time: float | None = None
    controller: Controller = field(init=False)
    simulator: Simulator = field(init=False)
    in_force: FirstOrderHold = field(init=False)
    decision: Decision = field(init=False)
    states: list[Vector] = field(default_factory=list)
    """Poses, (6,) each, at most `_SPACING` apart."""
    is_new: list[bool] = field(default_factory=list)
    """Whether the plan of each instant is a new one."""

    def __post_init__(self) -> None:
        self.simulator = Simulator(
            SimulatorSettings(initial_state=tuple(self.start)), self.plant,
            make_plant("rolling", self.plant, self.start),
        )
        clock, delay = (lambda: self.simulator.time), self.search_time
        self.worker = DelayedWorker(clock, 0.0 if delay is None else delay)
        self.controller = Controller(
            self.settings, ROBOT, self.strategy, worker=None if delay is None else self.worker
        )
        self.controller.floor = self.floor
        if self.goal is not None:
            self.controller.set_goal(self.goal)

    @property
    def pose(self) -> Vector:
        """The pose of the sphere now, shape (6,)."""
        return self.simulator.plant.state[POSE]

    @property
    def places(self) -> Vector:
        """All positions, shape (K, 2)."""
        return np.array(self.states)[:, POSITION]

    @property
    def given_up(self) -> str:
        """What the newest plan has given up."""
        return self.decision.plan.given_up

    @property
    def has_moved(self) -> bool:
        """Whether the sphere is elsewhere than at its start."""
        return not (self.pose == self.start).all()

    def sample(self, seen: bool = True) -> Kind:
        """Let the controller decide for now; `seen` says whether it gets a pose."""
        now = self.simulator.time
        if seen:
            self.controller.observe(now, self.simulator.measured_state())
        self.decision = self.controller.decide(now)
        self.is_new.append(self.decision.is_new)
        if self.delay:
            self.advance(self.delay)
        hold = self.controller.commit(self.decision, self.simulator.time)
        if hold is not None:
            self.in_force = hold
            self.simulator.follower.follow_trajectory(hold)
        return self.decision.mode

    def advance(self, duration: float) -> None:
        """Let time pass [s], and keep the states."""
        end = self.simulator.now + round(duration * NANOSECONDS)
        while self.simulator.now < end:
            self.states.append(self.pose)
            self.simulator.advance_to(
                min(end, self.simulator.now + round(_SPACING * NANOSECONDS))
            )
        self.states.append(self.pose)

    def run(self, duration: float) -> None:
        """Sample until a time that need not be an instant [s]."""
        end, period = self.simulator.time + duration, self.settings.control_period
        while self.simulator.time < end - 1e-9:
            self.sample()
            self.advance(min(period - self.delay, end - self.simulator.time))

    def path(self) -> Vector:
        """Return the path of the hold in force from now on, at poses 1 mm apart, shape (K, 6)."""
        now = self.simulator.time
        rest = self.in_force.starting_at(now, self.in_force.at(now))
        return moved(without_momentum(self.pose), rest, now, rest.end, 1e-3)[:, POSE]
