# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rest and stops: commands that bring the sphere to rest, and hold the momentum there."""

from dataclasses import replace

import numpy as np

from sphere_nmpc.model.disturbance import Disturbance, is_zero, rest_speeds, speeds_at_rest
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, QUATERNION, Vector
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus

REST_TIME = 1.0
"""Time for which a command goes on to hold the momentum at its end [s], should no other follow."""
_SPACING = 0.25
"""Spacing of the knots along which a command follows the momentum [s]; on a slope the speeds of
rest change linearly, and an imbalance turns with the sphere, which rests."""


def speeds_of_rest(momentum: Vector, quaternion: Vector, max_speed: float) -> Vector:
    """Return the speeds that hold the momentum, clipped to the limit [rad/s], shape (2,)."""
    speeds = rest_speeds(momentum, quaternion)
    held: Vector = np.minimum(np.maximum(speeds, -max_speed), max_speed)
    return held


def hold_momentum(
    hold: FirstOrderHold, momentum: Vector, disturbance: Disturbance, quaternion: Vector,
    max_speed: float, duration: float = REST_TIME,
) -> FirstOrderHold:
    """Return the hold to an arrival, extended to keep the sphere at rest for `duration` [s].

    `momentum` is that at the arrival; up to `max_speed` [rad/s] the rotors hold the momentum.
    """
    steps = max(1, round(duration / _SPACING))
    after = duration * np.arange(1, steps + 1) / steps
    speeds: Vector = np.zeros((steps, INPUT_SIZE))
    if not is_zero(momentum, disturbance):
        speeds = speeds_at_rest(momentum, disturbance, quaternion, after)
        speeds = np.minimum(np.maximum(speeds, -max_speed), max_speed)
    return hold.followed_by(FirstOrderHold(
        np.append(hold.end, hold.end + after), np.vstack((hold.speeds[-1], speeds))
    ))


def come_to_rest(
    situation: Situation, robot: RobotParameters, message: str,
    status: PlanStatus = PlanStatus.HOLDING,
) -> Plan:
    """Return a plan that brings the rotors to the speeds of rest and holds the momentum."""
    momentum, quaternion = situation.momentum, situation.state[QUATERNION]
    limit = robot.max_rotor_speed
    target = speeds_of_rest(momentum, quaternion, limit)
    # The rotors rest, but for the speeds that hold the momentum.
    beyond = FirstOrderHold.constant(situation.time, situation.input_in_force - target)
    ramp = beyond.stop(situation.time, robot.max_rotor_acceleration)
    hold = FirstOrderHold(ramp.times, ramp.speeds + target)
    hold = hold_momentum(hold, momentum, situation.disturbance, quaternion, limit)
    states: Vector = situation.state[None, :]
    return Plan(status, hold, states, message=message)


def stop(situation: Situation, robot: RobotParameters, message: str, given_up: str = "") -> Plan:
    """Return a plan to rest on the path in force, which what is on the floor is clear of."""
    status, in_force = PlanStatus.RAMP_TO_REST, situation.in_force
    moving = bool(np.any(situation.input_in_force)) and situation.has_small_momentum
    if in_force is None or not moving:
        plan = come_to_rest(situation, robot, message, status)
        return replace(plan, given_up=given_up)
    in_force = in_force.starting_at(situation.time, situation.input_in_force)
    limit = min(robot.max_rotor_acceleration, situation.acceleration)
    hold = in_force.stop(situation.time, limit)
    return Plan(status, hold, situation.state[None, :], message=message, given_up=given_up)
