# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The closed loop without ROS: the nodes' own simulator and controller, called in turn."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_sim.world.simulator import NANOSECONDS, Simulator


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What happened in a run.

    Attributes
    ----------
    times : ndarray, shape (K,)
        Times of the samples [s].
    states : ndarray, shape (K, 6)
        True states of the plant.
    speeds : ndarray, shape (K, 2)
        True rotor speeds [rad/s].
    torques : ndarray, shape (K, 2)
        Motor torques [N m].
    decisions : list of Decision
        One a sample instant.
    holds : list of FirstOrderHold
        What was sent; each is followed until the next one starts.
    """

    times: Vector
    states: Vector
    speeds: Vector
    torques: Vector
    decisions: list[Decision]
    holds: list[FirstOrderHold] = field(default_factory=list)


def run_closed_loop(
    simulator: Simulator,
    controller: Controller,
    goal: Vector,
    duration: float,
    control_period: float,
    output_period: float = 0.01,
    latency: float = 0.0,
) -> Trajectory:
    """Run a controller on a simulated plant.

    Parameters
    ----------
    simulator : Simulator
        The world, at its start.
    controller : Controller
        Fresh.
    goal : ndarray, shape (6,)
        Where to go.
    duration : float
        Length of the run [s].
    control_period : float
        Time between sample instants [s].
    output_period : float, optional
        Spacing of the rows of the result [s].
    latency : float, optional
        Age of the pose that is the newest one at a sample instant [s]; it carries the time at
        which it was measured. Before the run the sphere was seen standing at its start. Only
        for a sensor without rate, latency and drop-outs of its own; others see for themselves.

    Returns
    -------
    Trajectory

    Raises
    ------
    InvalidParameterError
        If a latency is given for a sensor that has its own.
    """
    if latency and not simulator.settings.is_sensor_plain:
        raise InvalidParameterError("latency", latency, "0 for a sensor with rate or latency")
    controller.set_goal(goal)
    control, output = round(control_period * NANOSECONDS), round(output_period * NANOSECONDS)
    end = round(duration * NANOSECONDS)
    delay = round(latency * NANOSECONDS)
    rows: list[tuple[float, Vector, Vector, Vector]] = []
    decisions: list[Decision] = []
    holds: list[FirstOrderHold] = []
    under_way: deque[tuple[int, float, Vector]] = deque()
    plain = simulator.settings.is_sensor_plain
    if plain:
        under_way.append((0, 0.0, simulator.measured_state()))
    plant = simulator.plant
    while True:
        now = simulator.now
        if now % output == 0:
            rows.append((simulator.time, plant.state, plant.rotor_speeds, plant.rotor_torques))
        if now >= end:
            break
        if plain and (now + delay) % control == 0 and now > 0:
            under_way.append((now + delay, simulator.time, simulator.measured_state()))
        if not plain:
            for at, seen in simulator.poses():
                controller.observe(at / NANOSECONDS, seen)
        if now % control == 0:
            while under_way and under_way[0][0] <= now:
                _, stamp, state = under_way.popleft()
                controller.observe(stamp, state)
            decision = controller.decide(simulator.time)
            hold = controller.commit(decision, simulator.time)
            if hold is not None:
                simulator.follower.follow_trajectory(hold)
                holds.append(hold)
            decisions.append(decision)
        measured = _next(now + delay, control) - delay
        simulator.advance_to(min(_next(now, control), _next(now, output), measured, end))
    times, states, speeds, torques = (np.array(column) for column in zip(*rows, strict=True))
    return Trajectory(times, states, speeds, torques, decisions, holds)


def _next(now: int, period: int) -> int:
    return (now // period + 1) * period
