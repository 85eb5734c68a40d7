# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop of a controller and the simulator, in which anything may happen at any time.

Events come between two calls of `SampledLoop.run`, and rules are checked on what it keeps.
"""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np
from delayed_worker import DelayedWorker
from motions import largest_slope, moved

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.estimation.pose_filter import Estimate
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.plant import PlantEstimate
from sphere_nmpc.model.state import POSE, POSITION, Vector, state_error, without_momentum
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Strategy
from sphere_nmpc.strategy.plan import Plan
from sphere_sim.evaluation.metrics import state_errors, stay_below
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()


@dataclass
class SampledLoop:
    """Closed loop of a sphere from rest at `start`, shape (6,), on.

    The sphere is that of `robot`, or a `plant` that is given, in a `world`; the controller knows
    it as `nominal`. `simulated` are further settings of the simulator. Each command is sent
    `delay` [s] after its decision. A worker answers a search after `search_time` [s]; without, it
    is searched in line. `strategy` replaces that of the settings.
    """

    start: Vector
    settings: ControllerSettings = field(default_factory=ControllerSettings)
    robot: RobotParameters = ROBOT
    _: KW_ONLY
    goal: Vector | None = None
    floor: Floor | None = None
    strategy: Strategy | None = None
    nominal: RobotParameters = ROBOT
    plant: Plant | None = None
    world: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    simulated: Mapping[str, Any] = field(default_factory=dict)
    is_known: bool = False
    """Whether the controller knows state and disturbance exactly, rather than by an estimator."""
    delay: float = 0.0
    search_time: float | None = None
    spacing: float = 5e-3
    """Largest spacing of the states that are kept [s]."""

    def __post_init__(self) -> None:
        given = SimulatorSettings(initial_state=tuple(self.start), **self.simulated)
        self.plant = self.plant or make_plant(
            given.plant, self.robot, self.start, disturbances=self.world
        )
        self.simulator = Simulator(given, self.robot, self.plant)
        self.worker = DelayedWorker(lambda: self.simulator.time, self.search_time or 0.0)
        self.controller = Controller(
            self.settings, self.nominal, self.strategy,
            worker=None if self.search_time is None else self.worker,
        )
        if self.is_known:
            self.controller.estimator = self.controller.following.estimator = Known(self)
        self.controller.floor = self.floor
        if self.goal is not None:
            self.controller.set_goal(self.goal)
        self.decision: Decision
        self.in_force: FirstOrderHold
        self.decisions: list[Decision] = []
        self.holds: list[FirstOrderHold] = []
        self.keep_from_now_on()

    def keep_from_now_on(self) -> None:
        """Drop the times, poses, (6,), and rotor speeds, (2,), that were kept so far."""
        self.times: list[float] = []
        self.states: list[Vector] = []
        self.speeds: list[Vector] = []

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.simulator.time

    @property
    def pose(self) -> Vector:
        """The pose of the sphere now, shape (6,)."""
        return self.plant.state[POSE]

    @property
    def momentum(self) -> Vector:
        """Momentum of the plant [rad/s; world frame], shape (3,)."""
        return self.plant.momentum / self.robot.rotor_axial_inertia

    @property
    def places(self) -> Vector:
        """All positions, shape (K, 2)."""
        return np.array(self.states)[:, POSITION]

    @property
    def plans(self) -> list[Plan]:
        """The plan of each instant."""
        return [decision.plan for decision in self.decisions]

    @property
    def given_up(self) -> str:
        """What the newest plan has given up."""
        return self.decision.plan.given_up

    @property
    def has_moved(self) -> bool:
        """Whether the sphere is elsewhere than at its start."""
        return not (self.pose == self.start).all()

    def error(self, goal: Vector | None = None) -> float:
        """Return the distance of the sphere from its goal, or another one, in R^6."""
        return state_error(self.pose, self.goal if goal is None else goal)

    def errors(self, goal: Vector | None = None) -> Vector:
        """Return that of all states, shape (K,)."""
        return state_errors(np.array(self.states), self.goal if goal is None else goal)

    def settled(self, goal: Vector | None = None) -> float:
        """Return the time from which the error stays below 1e-2 [s]; inf where it does not."""
        stay = stay_below(np.array(self.times), self.errors(goal))
        return float("inf") if stay is None else stay.since

    def push_momentum(self, momentum: Vector) -> None:
        """Push so that the momentum jumps by `momentum`, shape (3,) [rad/s; world frame]."""
        size = self.robot.rotor_axial_inertia / self.robot.shell_radius
        self.plant.push(size * np.array([momentum[1], -momentum[0]]))

    def tilt(self, slope: float, direction: float = 0.0) -> None:
        """Change the inclination of the floor and its downhill direction [rad]."""
        self.world = DisturbanceSettings(slope=slope, slope_direction=direction)
        self.plant.tilt(slope, direction)

    def sample(self, seen: bool = True, ahead: float = 0.0) -> Kind:
        """Let the controller decide for a time `ahead` [s]; `seen` says whether it gets poses."""
        for stamp, pose in self.simulator.poses() if seen else ():
            self.controller.observe(stamp / NANOSECONDS, pose)
        self.decision = self.controller.decide(self.time + ahead)
        self.decisions.append(self.decision)
        if self.delay:
            self.advance(self.delay)
        hold = self.controller.commit(self.decision, self.time)
        if hold is not None:
            self.in_force = hold
            self.holds.append(hold)
            self.simulator.follower.follow_trajectory(hold)
        return self.decision.mode

    def advance(self, duration: float) -> None:
        """Let time pass [s], and keep the states."""
        end = self.simulator.now + round(duration * NANOSECONDS)
        step = round(self.spacing * NANOSECONDS)
        while self.simulator.now < end:
            self._keep()
            self.simulator.advance_to(min(end, self.simulator.now + step))
        self._keep()

    def _keep(self) -> None:
        self.times.append(self.time)
        self.states.append(self.pose)
        self.speeds.append(self.plant.rotor_speeds)

    def run(self, duration: float) -> list[Plan]:
        """Sample until a time that need not be an instant [s]; return the plans followed in it."""
        end, period = self.time + duration, self.settings.control_period
        before = len(self.decisions)
        while self.time < end - 1e-9:
            self.sample()
            self.advance(min(period - self.delay, end - self.time))
        return self.plans[before:]

    def run_with_area(self, corners: Vector, velocity: Vector, duration: float) -> Vector:
        """Run while an upright rectangle, by its corners, shape (4, 2) [m], moves on the floor.

        Ten times a second it is announced. Return whether the sphere has not come to rest, for
        each time that the rectangle begins to touch it, since it was last clear of it.
        """
        floor, since = self.controller.floor, self.time
        layers, first = Layers(map=floor.grid), len(self.times)
        while self.time < since + duration - 1e-9:
            moved = layers.with_keepout(1, corners + (self.time - since) * velocity)
            self.controller.floor = Floor(moved.grid(floor.radius), floor.radius, floor.clearance)
            self.run(0.1)
        places, way = self.places[first:], np.outer(np.array(self.times[first:]) - since, velocity)
        away = places - np.clip(places, corners.min(axis=0) + way, corners.max(axis=0) + way)
        distances, moves = np.linalg.norm(away, axis=1), np.diff(places, axis=0).any(axis=1)
        touches = distances < floor.radius
        clear = np.flatnonzero(distances > floor.needed)
        begun = np.flatnonzero(touches[1:] & ~touches[:-1])
        return np.array([moves[clear[clear <= k][-1] : k + 1].all() for k in begun], dtype=bool)

    def path(self) -> Vector:
        """Return the path of the hold in force from now on, at poses 1 mm apart, shape (K, 6)."""
        rest = self.in_force.starting_at(self.time, self.in_force.at(self.time))
        return moved(without_momentum(self.pose), rest, self.time, rest.end, 1e-3)[:, POSE]

    def check_limits(self) -> None:
        """Check the rotor speeds, and every command that was sent, to its end at rest."""
        assert np.max(np.abs(self.speeds)) <= self.robot.max_rotor_speed
        for hold in self.holds:
            check_hold(hold, self.robot)


def check_hold(
    hold: FirstOrderHold, robot: RobotParameters = ROBOT, slack: float = 1e-8
) -> None:
    """Check that a command keeps the limits of speed and acceleration, and ends at rest.

    Accelerations may be larger by a share `slack`: rounding of 100 rad/s over an interval.
    """
    assert np.max(np.abs(hold.speeds)) <= robot.max_rotor_speed + 1e-9
    assert largest_slope(hold) <= robot.max_rotor_acceleration * (1.0 + slack)
    np.testing.assert_array_equal(hold.speeds[-1], [0.0, 0.0])


class Known:
    """`Estimator` of a loop with nothing to be estimated."""

    def __init__(self, loop: SampledLoop) -> None:
        self._loop = loop
        self._world, self.disturbance = loop.world, disturbance_of(loop.world, loop.robot)
        self.plant = PlantEstimate(loop.robot.lumped)

    @property
    def newest(self) -> tuple[float, Vector]:
        return self._loop.time, self._loop.pose

    @property
    def momentum(self) -> Vector:
        return self._loop.momentum

    def observe(self, time: float, pose: Vector) -> bool:
        return True

    def estimate(self, time: float) -> Estimate:
        loop = self._loop
        if loop.world is not self._world:
            self._world, self.disturbance = loop.world, disturbance_of(loop.world, loop.robot)
        state = np.concatenate((loop.pose, loop.momentum))
        return Estimate(state, self.plant, disturbance=self.disturbance)


def settling_time(strategy: str, start: Vector, goal: Vector, duration: float,
                  robot: RobotParameters = ROBOT) -> float:
    """Return the time from which a strategy is near its goal [s]; inf where it is not."""
    settings = ControllerSettings(strategy=strategy).of(robot)
    loop = SampledLoop(
        start, settings, robot, nominal=robot, goal=goal, is_known=True,
        spacing=settings.period / 10.0,
    )
    loop.run(duration)
    loop.check_limits()
    return loop.settled()
