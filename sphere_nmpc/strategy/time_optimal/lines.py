# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motions along straight lines, from any orientation: what leads through where a search does not.

Let the sphere without momentum roll by an angle about a horizontal axis a, z the body's z axis,
z3 its vertical component and p = 1 / (1 - r3). The momentum about z is zero, which no rotor
changes, so that the sphere spins about the vertical by -p (z . a) / z3 for each radian that it
rolls, and

    (z . a) / abs(z3)^p = C

is constant along a line: the spin is known from z3 alone. On the circle where z is horizontal all
lines meet with z . a = 0 and without a spin. There C may be chosen anew, and with C = 0 the sphere
rolls on without a spin. Gone back along, such a motion leads to a given pose.
"""

import math

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import INPUT_SIZE, POSITION, QUATERNION, Vector
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver

_STEP = 1.0 / 80.0
"""Largest step in which the orientation is integrated [rad]."""
_HORIZONTAL_ANGLE = 5e-3
"""Angle [rad] up to which the body's z axis counts as horizontal, where the sphere turns in place
until it can roll along the line: the centre moves by 3 mm at the most."""
_TURNED: Vector = np.linspace(0.0, 1.0, 9, dtype=np.float64)
"""Shares of such a turn at its knots."""
_KNOT_SPACINGS = 0.5, 0.25, 0.12, 0.06
"""Spacings of the knots [of the fine ones of a plan], of which the first one is taken with which
the motion ends within `Margin.KEPT`: the speeds between knots are linear."""
_PACE_SHARE = 0.5
"""Share of the limit of the rotors' acceleration for the change of the pace; the rest is for that
of the direction."""


def rotor_speeds(turn: Vector, rate: Vector, constants: LumpedConstants) -> Vector:
    """Return the rotor speeds at which the sphere turns at a `rate` [rad/s; world], shape (2,).

    `turn` is the rotation from body to world; see `sphere_nmpc.model.dynamics`.
    """
    momentum = rate - (0.0, 0.0, constants.transverse_ratio * rate[2])
    speeds: Vector = -(momentum @ turn[:, :2]) / constants.input_gain
    return speeds


def speeds_along(
    quaternion: Vector, direction: Vector, angle: float, constants: LumpedConstants
) -> tuple[Vector, Vector]:
    """Return angles that are rolled on a line [rad], and the rotor speeds there for 1 rad/s.

    Parameters
    ----------
    quaternion : ndarray, shape (4,)
        Orientation at the start.
    direction : ndarray, shape (2,)
        Unit vector of the line.
    angle : float
        Angle to roll [rad].
    constants : LumpedConstants
        Constants of the robot.

    Returns
    -------
    angles : ndarray, shape (K,)
        From 0 to `angle`, as closely spaced as the spin takes.
    speeds : ndarray, shape (K, 2)
        Rotor speeds over the angular velocity of rolling [-].
    """
    power, axis = 1.0 / (1.0 - constants.axial_ratio), np.array((-direction[1], direction[0], 0.0))
    z = rotation.matrix(quaternion)[:, 2]
    side = math.copysign(1.0, z[2])
    constant = 0.0 if abs(z[2]) < _HORIZONTAL_ANGLE else float(z @ axis) / abs(z[2]) ** power

    def turning(turn: Vector) -> Vector:
        """Return the angular velocity at an orientation, for 1 rad/s of rolling."""
        spin = -power * constant * side * max(0.0, side * float(turn[2, 2])) ** (power - 1.0)
        return np.array((axis[0], axis[1], spin))

    angles, speeds, done, longest = [0.0], list[Vector](), 0.0, min(_STEP, 0.25 * angle)
    while True:
        turn = rotation.matrix(quaternion)
        rate = turning(turn)
        speeds.append(rotor_speeds(turn, rate, constants))
        if done >= angle:
            return np.array(angles), np.array(speeds)
        step = min(longest / max(1.0, abs(rate[2])), angle - done)
        middle = rotation.product(rotation.exponential(0.5 * step * rate), quaternion)
        rate = turning(rotation.matrix(middle))
        quaternion = rotation.product(rotation.exponential(step * rate), quaternion)
        if side * rotation.matrix(quaternion)[2, 2] < 0.0:
            constant = 0.0
        done = angle if angle - done - step < 1e-9 * angle else done + step
        angles.append(done)


def line_hold(
    state: Vector, target: Vector, constants: LumpedConstants, solver: ArrivalSolver
) -> FirstOrderHold | None:
    """Return rotor speeds that roll the sphere straight to a place, from rest to rest.

    Parameters
    ----------
    state : ndarray, shape (9,)
        Pose at the start, without momentum.
    target : ndarray, shape (2,)
        The place [m].
    constants : LumpedConstants
        Constants of the robot.
    solver : ArrivalSolver
        Solver with the limits of the drives.

    Returns
    -------
    FirstOrderHold or None
        None at the place itself.
    """
    limit, rate = solver.robot.max_rotor_speed, solver.robot.max_rotor_acceleration
    way, radius, numbers = target - state[POSITION], constants.shell_radius, constants.as_array()
    if float(np.linalg.norm(way)) < 1e-6:
        return None
    turned, there = FirstOrderHold.constant(0.0, np.zeros(INPUT_SIZE)), state
    missing = _missing_turn(state[QUATERNION], way)
    if missing:
        spin = np.array((0.0, 0.0, math.copysign(1.0, missing)))
        speed = rotor_speeds(rotation.matrix(state[QUATERNION]), spin, constants)
        speeds = np.tile(speed, (_TURNED.size, 1))
        turned = _at_full_pace(abs(missing) * _TURNED, speeds, limit, rate)
        there = roll_out(state, turned.speeds, turned.durations, numbers)[-1]
        way = target - there[POSITION]
    length = float(np.linalg.norm(way))
    at, speeds = speeds_along(there[QUATERNION], way / length, length / radius, constants)
    fastest = _at_full_pace(at, speeds, limit, rate)
    for spacing in _KNOT_SPACINGS:
        count = max(4, math.ceil(fastest.end / (spacing * solver.grid.fine)))
        rolled = fastest.resampled(np.linspace(0.0, fastest.end, count + 1, dtype=np.float64))
        line = turned.followed_by(rolled.delayed(turned.end))
        end = roll_out(state, line.speeds, line.durations, numbers)[-1, POSITION]
        if float(np.linalg.norm(end - target)) < Margin.KEPT.value * radius:
            break
    return line


def _missing_turn(quaternion: Vector, direction: Vector) -> float:
    """Return the turn in place [rad] after which the sphere rolls in a direction without a spin.

    It is 0 where the body's z axis is not horizontal, as the sphere cannot turn in place there.
    """
    x, y, vertical = rotation.matrix(quaternion)[:, 2].tolist()
    along = math.atan2(x * direction[1] - y * direction[0], x * direction[0] + y * direction[1])
    missing = math.remainder(along, math.pi)
    return missing if abs(vertical) < _HORIZONTAL_ANGLE < abs(missing) else 0.0


def _at_full_pace(at: Vector, speeds: Vector, limit: float, rate: float) -> FirstOrderHold:
    """Return the fastest hold through rotor speeds at angles [rad], from rest to rest.

    The speeds, shape (K, 2), are those for 1 rad/s. Both rotors keep the limits of their speeds
    [rad/s] and accelerations [rad/s^2].
    """
    steps = np.diff(at)
    largest = np.max(np.abs(speeds), axis=1)
    change = np.max(np.abs(np.diff(speeds, axis=0)), axis=1) / steps
    change = np.maximum(np.append(change, 0.0), np.append(0.0, change))
    squares = np.minimum(
        (limit / largest) ** 2, (1.0 - _PACE_SHARE) * rate / np.maximum(change, 1e-12)
    )
    rises = 2.0 * steps * _PACE_SHARE * rate / np.maximum(largest[1:], largest[:-1])
    squares[0] = squares[-1] = 0.0
    for k, rise in enumerate(rises):
        squares[k + 1] = min(squares[k + 1], squares[k] + rise)
    for k in range(rises.size - 1, -1, -1):
        squares[k] = min(squares[k], squares[k + 1] + rises[k])
    paces = np.sqrt(squares)
    times = np.concatenate(([0.0], np.cumsum(2.0 * steps / (paces[1:] + paces[:-1]))))
    return FirstOrderHold(times, np.clip(paces[:, None] * speeds, -limit, limit))


def gone_back(hold: FirstOrderHold) -> FirstOrderHold:
    """Return the hold by which the sphere goes back along the motion of another, from rest."""
    return FirstOrderHold(hold.end - hold.times[::-1], -hold.speeds[::-1])
