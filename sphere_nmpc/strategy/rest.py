# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rest and stops: commands that bring the sphere to rest, and hold the momentum there."""

import numpy as np

from sphere_nmpc.model.disturbance import Disturbance, is_zero, rest_speeds, speeds_at_rest
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, QUATERNION, Vector
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus

_AFTER: Vector = np.array((0.25, 0.5, 0.75, 1.0))
"""Times after an arrival [s] at which a command holds the momentum, should no other follow: on a
slope the speeds of rest change linearly, and an imbalance turns with the sphere, which rests."""


def speeds_of_rest(momentum: Vector, quaternion: Vector, max_speed: float) -> Vector:
    """Return the speeds that hold the momentum, clipped to the limit [rad/s], shape (2,)."""
    speeds = rest_speeds(momentum, quaternion)
    held: Vector = np.minimum(np.maximum(speeds, -max_speed), max_speed)
    return held


def hold_momentum(
    arrival: FirstOrderHold, momentum: Vector, disturbance: Disturbance, quaternion: Vector,
    max_speed: float,
) -> FirstOrderHold:
    """Return what follows an arrival to keep the sphere at rest, for a second.

    `momentum` is that at the arrival; up to `max_speed` [rad/s] the rotors hold the momentum.
    """
    held: Vector = np.zeros((_AFTER.size, INPUT_SIZE))
    if not is_zero(momentum, disturbance):
        held = speeds_at_rest(momentum, disturbance, quaternion, _AFTER)
        held = np.minimum(np.maximum(held, -max_speed), max_speed)
    end = arrival.end
    return FirstOrderHold(
        np.append(end, end + _AFTER), np.vstack((arrival.speeds[-1], held))
    )


def come_to_rest(
    situation: Situation, robot: RobotParameters, message: str,
    status: PlanStatus = PlanStatus.HOLDING,
) -> Plan:
    """Return a plan that brings the rotors to the speeds of rest and holds the momentum."""
    momentum, quaternion = situation.momentum, situation.state[QUATERNION]
    limit = robot.max_rotor_speed
    target = speeds_of_rest(momentum, quaternion, limit)
    # The rotors rest, but for the speeds that hold the momentum.
    beyond = FirstOrderHold.constant(situation.time, situation.speeds - target)
    ramp = beyond.stop(situation.time, robot.max_rotor_acceleration)
    hold = FirstOrderHold(ramp.times, ramp.speeds + target)
    hold = hold.followed_by(
        hold_momentum(hold, momentum, situation.disturbance, quaternion, limit)
    )
    return _plan(situation, hold, message, status)


def stop(situation: Situation, robot: RobotParameters, message: str) -> Plan:
    """Return a plan to rest on the path in force, which what is on the floor is clear of."""
    status = PlanStatus.RAMP_TO_REST
    if not (situation.speeds.any() and situation.has_small_momentum):
        return come_to_rest(situation, robot, message, status)
    limit = min(robot.max_rotor_acceleration, situation.plant.acceleration)
    hold = situation.in_force.stop(situation.time, limit)
    return _plan(situation, hold, message, status)


def _plan(situation: Situation, hold: FirstOrderHold, message: str, status: PlanStatus) -> Plan:
    conditions = (Condition(Kind.PLANNED, message),)
    return Plan(hold, situation.state[None, :], status, conditions=conditions)
