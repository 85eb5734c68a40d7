# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rest and stops, with momentum too: commands that hold it, and the nearest goal to hold it at.

The rotors hold what is perpendicular to the body's z axis. Momentum that comes from pushes, slopes
and imbalance is horizontal, so every upright goal can be held; at another one the component along
that axis would turn the sphere. At rest on a slope or out of balance the momentum grows, so that
its rate must be perpendicular to the axis, too.
"""

from dataclasses import replace

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import Disturbance, rest_speeds, speeds_at_rest
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path_stop import stop_on_path
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus

SATURATED = "rest: the rotors cannot hold the momentum, they stay at their limits"
"""What is given up where a rotor would have to exceed its limit."""
REST_TIME = 1.0
"""Time for which a command goes on to hold the momentum at its end [s], should no other follow."""
_SPACING = 0.25
"""Spacing of the knots along which a command follows the momentum [s]; on a slope the speeds of
rest change linearly, and an imbalance turns with the sphere, which rests."""
MOMENTUM_TOLERANCE = 0.05
"""Component along the body's z axis [rad/s] that is left: it turns the sphere by 1e-2 in some
seconds."""
TORQUE_TOLERANCE = 0.05
"""Component of the momentum's rate along the body's z axis [rad/s^2] that is left."""
_TOLERANCES = np.array([MOMENTUM_TOLERANCE, TORQUE_TOLERANCE])
_LEAST_TOLD = 1e-2
"""Change of the orientation [rad] that is told; one below it is half the error at which a goal
counts as reached."""
_ITERATIONS = 20
_STEP = 1e-6
"""Step of the difference quotients [rad]."""
_LARGEST_TURN = 0.5
"""Largest change of an iteration [rad]."""


def speeds_of_rest(momentum: Vector, quaternion: Vector, max_speed: float) -> Vector:
    """Return the speeds that hold the momentum, clipped to the limit [rad/s], shape (2,)."""
    speeds = rest_speeds(momentum, quaternion)
    held: Vector = np.minimum(np.maximum(speeds, -max_speed), max_speed)
    return held


def is_saturated(momentum: Vector, quaternion: Vector, max_speed: float) -> bool:
    """Return whether a rotor would have to exceed its limit to hold the momentum."""
    return bool(np.max(np.abs(rest_speeds(momentum, quaternion))) > max_speed)


def hold_momentum(
    hold: FirstOrderHold, momentum: Vector, disturbance: Disturbance, quaternion: Vector,
    max_speed: float, duration: float = REST_TIME,
) -> FirstOrderHold:
    """Return the hold to an arrival, extended to keep the sphere at rest for `duration` [s].

    `momentum` is that at the arrival; up to `max_speed` [rad/s] the rotors hold the momentum.
    """
    steps = max(1, round(duration / _SPACING))
    after = duration * np.arange(1, steps + 1) / steps
    speeds = speeds_at_rest(momentum, disturbance, quaternion, after)
    speeds = np.minimum(np.maximum(speeds, -max_speed), max_speed)
    return FirstOrderHold(
        np.concatenate((hold.times, hold.end + after)), np.concatenate((hold.speeds, speeds))
    )


def ramp_to(
    time: float, speeds: Vector, target: Vector, max_acceleration: float
) -> FirstOrderHold:
    """Return the ramp from rotor `speeds` at `time` to `target`, both of shape (2,) [rad/s].

    Both rotors end it at the same time.
    """
    ramp = FirstOrderHold.ramp_to_rest(time, speeds - target, max_acceleration)
    return FirstOrderHold(ramp.times, ramp.speeds + target)


def come_to_rest(
    situation: Situation, robot: RobotParameters, message: str,
    status: PlanStatus = PlanStatus.HOLDING,
) -> Plan:
    """Return a plan that brings the rotors to the speeds of rest and holds the momentum."""
    momentum, quaternion = situation.momentum, situation.state[QUATERNION]
    limit = robot.max_rotor_speed
    target = speeds_of_rest(momentum, quaternion, limit)
    in_force = situation.input_in_force
    hold = ramp_to(situation.time, in_force, target, robot.max_rotor_acceleration)
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
    hold = stop_on_path(in_force, min(robot.max_rotor_acceleration, situation.acceleration))
    return Plan(status, hold, situation.state[None, :], message=message, given_up=given_up)


def holdable_goal(goal: Vector, momentum: Vector, disturbance: Disturbance) -> Vector:
    """Return the goal, shape (6,), with the nearest orientation that can be held.

    It is the same object where the momentum at the arrival can be held there.
    """
    q = goal[QUATERNION]
    found = _excess(q, momentum, disturbance)
    if not found.any():
        return goal
    violated = found != 0.0
    for _ in range(_ITERATIONS):
        # A condition that has been violated once is kept from then on: corrected one at a time,
        # in turn, two that are nearly parallel would take hundreds of iterations.
        violated |= found != 0.0
        here, _ = _components(q, momentum, disturbance)
        near = (_components(_turned(q, s), momentum, disturbance)[0] for s in _STEP * np.eye(3))
        columns = [(there - here) / _STEP for there in near]
        jacobian = violated[:, None] * np.column_stack(columns)
        turn = -np.linalg.pinv(jacobian, rcond=1e-6) @ found
        angle = float(np.linalg.norm(turn))
        q = _turned(q, turn * min(1.0, _LARGEST_TURN / max(angle, _STEP)))
        found = _excess(q, momentum, disturbance)
        if not found.any():
            break
    held: Vector = goal.copy()
    held[QUATERNION] = q
    return held


def given_up_angle(angle: float) -> str:
    """Return what is given up by a change of the goal's orientation [rad], empty if little."""
    if angle < _LEAST_TOLD:
        return ""
    return f"orientation by {np.degrees(angle):.1f} deg: the rotors cannot hold the momentum there"


def _components(q: Vector, momentum: Vector, disturbance: Disturbance) -> tuple[Vector, Vector]:
    """Return the shares of h and dh/dt along the body's z axis, and their lengths, (2,) each."""
    vectors = np.array((momentum, disturbance.at_rest(q)))
    lengths = np.maximum(np.sqrt(np.sum(vectors * vectors, axis=1)), 1e-12)
    return vectors @ rotation.matrix(q)[:, 2] / lengths, lengths


def _excess(q: Vector, momentum: Vector, disturbance: Disturbance) -> Vector:
    """Return what the shares of h and dh/dt exceed their tolerances by, shape (2,)."""
    along, lengths = _components(q, momentum, disturbance)
    allowed = _TOLERANCES / lengths
    excess: Vector = np.copysign(np.maximum(0.0, np.abs(along) - allowed), along)
    return excess


def _turned(q: Vector, turn: Vector) -> Vector:
    turned = rotation.product(q, rotation.exponential(turn))
    normalised: Vector = turned / np.linalg.norm(turned)
    return normalised
