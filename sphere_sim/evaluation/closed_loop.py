# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop without ROS: the simulator and the controller of the nodes, called in turn."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_sim.evaluation.metrics import errors_to, stay_below
from sphere_sim.evaluation.series import RobotSeries, Series
from sphere_sim.world.disturbances import Push
from sphere_sim.world.simulator import Simulator

AT_PUSH_SIZE = 11
"""Size of `Trajectory.at_push` after a push."""


@dataclass(frozen=True, eq=False)
class Trajectory(RobotSeries):
    """True trajectory of a run, with decisions and commands of the controller.

    Attributes
    ----------
    decisions : list of Decision
        One for each sampling instant.
    holds : list of FirstOrderHold
        Commands; each is followed until the next one starts.
    goal : Goal
        The goal, of several the last one.
    at_push : ndarray, shape (11,) or (0,)
        State, rotor speeds [rad/s] and momentum [N m s; world frame] just after the push; empty
        without one.
    """

    goal: Goal
    decisions: list[Decision]
    holds: list[FirstOrderHold] = field(default_factory=list)
    at_push: Vector = field(default_factory=lambda: np.empty(0))

    @cached_property
    def errors(self) -> Vector:
        """Error ||x - x_d|| to the goal over time [mixed units], shape (n,)."""
        return errors_to(self.goal, self.states)[:, 0]

    @property
    def settled_after(self) -> float:
        """Time into the run from which the error stays below 1e-2 [s]; nan where it does not."""
        stay = stay_below(self.times - self.times[0], self.errors)
        return math.nan if stay is None else stay.since


def run_closed_loop(
    simulator: Simulator, controller: Controller, goal: ArrayLike | Goal | Course,
    duration: float, output_period: float = 0.01, latency: float = 0.0,
    push: Push | None = None, poses: Callable[[], list[tuple[int, Vector]]] | None = None,
) -> Trajectory:
    """Simulate a plant under a new controller with a goal, a set or shape (6,), or a course.

    The run begins at the time and state of the simulator and lasts `duration`, with a sampling
    instant every period of the controller and a row of the trajectory every `output_period`, which
    the controller does not see [s]. `latency` is the age of the newest pose at a sampling instant
    [s]; its stamp is the time of measurement, and before the run the sphere is measured as it is.
    `poses` returns stamps [ns] and poses, shape (6,), that are new; by default they are those of
    the simulator's sensor. `InvalidParameterError` is raised if a latency is given for a source of
    poses that has stamps of its own.
    """
    plain = poses is None and simulator.settings.is_sensor_plain
    if latency and not plain:
        raise InvalidParameterError(
            "latency", latency, "0 for a sensor with rate or latency, and for an odometry"
        )
    new_poses = poses or simulator.poses
    course = goal if isinstance(goal, Course) else Course.of(goal)
    controller.set_goal(course)
    control, output = (round(p * NANOSECONDS) for p in (controller.period, output_period))
    begin, delay = simulator.now, round(latency * NANOSECONDS)
    end = begin + round(duration * NANOSECONDS)
    push_at = -1 if push is None else begin + round(push.time * NANOSECONDS)
    at_push: Vector = np.empty(0)
    rows: list[tuple[float, Vector, Vector, Vector]] = []
    decisions: list[Decision] = []
    holds: list[FirstOrderHold] = []
    pending: deque[tuple[int, float, Vector]] = deque()
    if plain:
        pending.append((begin, simulator.time, simulator.measured_state()))
    plant = simulator.plant
    while True:
        now = simulator.now
        if push is not None and now == push_at:
            plant.push(push.impulse)
            at_push = np.concatenate((plant.state, plant.rotor_speeds, plant.momentum))
        if now % output == 0:
            rows.append((simulator.time, plant.state, plant.rotor_speeds, plant.rotor_torques))
        if now >= end:
            break
        if plain and (now + delay) % control == 0 and now > begin:
            pending.append((now + delay, simulator.time, simulator.measured_state()))
        if now % control == 0:
            if not plain:
                for stamp_ns, pose in new_poses():
                    controller.observe(stamp_ns / NANOSECONDS, pose)
            while pending and pending[0][0] <= now:
                _, stamp, state = pending.popleft()
                controller.observe(stamp, state)
            decision = controller.decide(simulator.time)
            hold = controller.commit(decision, simulator.time)
            if hold is not None:
                simulator.follower.follow_trajectory(hold)
                holds.append(hold)
            decisions.append(decision)
        measured = _next(now + delay, control) - delay
        then = min(_next(now, control), _next(now, output), measured, end)
        simulator.advance_to(min(then, push_at) if now < push_at else then)
    times, *columns = (np.array(column) for column in zip(*rows, strict=True))
    states, speeds, torques = (Series(times, column) for column in columns)
    return Trajectory(states, speeds, torques, course.goals[-1], decisions, holds, at_push)


def _next(now: int, period: int) -> int:
    return (now // period + 1) * period
