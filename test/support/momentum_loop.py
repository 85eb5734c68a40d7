# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop of a strategy on the ideal plant, with momentum and disturbance known exactly."""

from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.control.link import Commands
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation, Strategy, make_strategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
_STEPS = 10
"""Steps of the plant in a sample period."""


@dataclass
class MomentumLoop:
    """A strategy and a plant in a `world`; commands are joined as those of the controller."""

    start: Vector
    goal: Vector
    world: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    name: str = "time_optimal"
    planning_effort: int = 20_000
    robot: RobotParameters = ROBOT

    def __post_init__(self) -> None:
        settings = ControllerSettings(strategy=self.name, planning_effort=self.planning_effort)
        settings = settings.of(self.robot)
        self.period = settings.period
        self.strategy: Strategy = make_strategy(settings, self.robot)
        self.plant = RollingPlant(self.robot, self.start, self.world)
        self.commands = Commands(self.robot)
        self.samples = 0
        self.plans: list[Plan] = []
        self.holds: list[FirstOrderHold] = []
        self.errors: list[float] = []
        """Distance of the state from the goal in R^6 at each sample, before its plan."""
        self.momenta: list[Vector] = []
        """Momentum at each sample [rad/s; world frame]."""

    @property
    def time(self) -> float:
        """Control time [s]."""
        return self.samples * self.period

    @property
    def momentum(self) -> Vector:
        """True momentum h of the plant [rad/s; world frame], shape (3,)."""
        return self.plant.momentum / self.robot.rotor_axial_inertia

    @property
    def disturbance(self) -> Disturbance:
        """True disturbance of the plant."""
        return disturbance_of(self.world, self.robot)

    @property
    def error(self) -> float:
        """Present distance of the state from the goal in R^6."""
        return state_error(self.plant.state, self.goal)

    def push_momentum(self, momentum: Vector) -> None:
        """Push so that the momentum jumps by `momentum`, shape (3,) [rad/s; world frame]."""
        size = self.robot.rotor_axial_inertia / self.robot.shell_radius
        self.plant.push(size * np.array([momentum[1], -momentum[0]]))

    def tilt(self, slope: float, direction: float = 0.0) -> None:
        """Change the inclination of the floor and its downhill direction [rad]."""
        self.world = DisturbanceSettings(slope=slope, slope_direction=direction)
        self.plant.tilt(slope, direction)

    def situation(self) -> Situation:
        """Return the situation of now, with nothing to be estimated."""
        in_force = self.commands.sent.at(self.time)
        state = np.concatenate((self.plant.state, self.momentum))
        return Situation(
            self.time, state, self.goal, in_force, self.robot.lumped,
            disturbance=self.disturbance,
        )

    def run(self, duration: float) -> list[Plan]:
        """Continue for a time [s]; return the plans made in it."""
        before = len(self.plans)
        for _ in range(round(duration / self.period)):
            self.errors.append(self.error)
            self.momenta.append(self.momentum)
            plan = self.strategy.plan(self.situation())
            hold = self.commands.joined(plan.hold, self.time, self.period)
            self.commands.sent.record(hold)
            self.plans.append(plan)
            self.holds.append(hold)
            step = self.period / _STEPS
            for k in range(_STEPS):
                self.plant.advance(hold.at(self.time + (k + 1) * step), step)
            self.samples += 1
        return self.plans[before:]

    def check_limits(self) -> None:
        """Check every command that was sent, to its end."""
        for hold in self.holds:
            assert np.max(np.abs(hold.speeds)) <= self.robot.max_rotor_speed + 1e-9
            slopes = np.abs(np.diff(hold.speeds, axis=0)) / np.diff(hold.times)[:, None]
            assert np.max(slopes, initial=0.0) <= self.robot.max_rotor_acceleration + 1e-6
            np.testing.assert_array_equal(hold.speeds[-1], [0.0, 0.0])


def statuses(plans: list[Plan]) -> set[PlanStatus]:
    """Return the statuses of plans."""
    return {plan.status for plan in plans}


def settling_time(
    name: str, start: Vector, goal: Vector, duration: float, robot: RobotParameters = ROBOT
) -> float:
    """Return the sample from which a strategy is near its goal [s]; inf where it is not."""
    loop = MomentumLoop(
        start, goal, name=name, planning_effort=ControllerSettings.planning_effort, robot=robot
    )
    loop.run(duration)
    loop.check_limits()
    late = [k + 1 for k, error in enumerate([*loop.errors, loop.error]) if not error < 1e-2]
    settled = max(late, default=0)
    return settled * loop.period if settled <= loop.samples else float("inf")
