# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motions along straight lines, from any orientation: what leads through where a search does not.

The velocity of the centre is linear in the rotor speeds, v = V(q) u, and V is singular only where
the body's z axis is horizontal. So u = V^-1 d keeps the centre on a line of direction d from any
orientation; the rest of the rotation is a spin about the vertical. It is slow where the axis is
nearly horizontal and the line not the one along which the sphere then rolls without a spin. Gone
back along, such a motion leads to a given pose.
"""

import math

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import INPUT_SIZE, POSE, POSITION, QUATERNION, Vector
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival, ArrivalSolver

_STEP = 1.0 / 80.0
"""Step along the line in which the rotor speeds are found [Rs]."""
_PROBE = 1e-3
"""Duration of the motions by which the velocities are found [1 / (c1 u_max)]."""
_ROLLS, _ROLLS_SINGULAR = 5e-4, 5e-3
"""Angle [rad] between a line and the one along which the sphere rolls without a spin, below which
they count as one; the same where V is nearly singular."""
_SLOWEST = 100.0
"""Largest rotor speed for the centre's speed, over that of rolling without a spin."""
_SPACINGS = 0.5, 0.25, 0.12, 0.06
"""Spacings of the knots [of the fine ones of a plan], of which the first one is taken with which
the motion ends within `_MISSED`: the speeds between knots are linear."""
_MISSED = 0.007
"""Distance from its end [Rs] within which a motion has to arrive."""
_LEVEL = 0.05
"""Tilt of the body's z axis from the vertical [-] below which all lines are nearly such ones."""
_REGULAR, _SINGULAR, _EVEN = 1e-3, 0.02, 0.2
"""Ratios of the singular values of V: from the first one on it is inverted, below the second one
it is nearly singular, and below the third one the steps are smaller."""
_HORIZONTAL = 5e-3
"""Tilt of the body's z axis from the horizontal [rad] up to which the sphere turns in place: the
centre moves by 3 mm at the most."""
_RISING = 0.5
"""Share of the limit of the rotors' acceleration for the change of the pace; the rest is for that
of the direction."""


def velocities(state: Vector, constants: LumpedConstants, duration: float) -> Vector:
    """Return V(q): the centre's velocity for a unit speed of each rotor [m/rad], shape (2, 2)."""
    columns = []
    for unit in np.eye(2):
        end = roll_out(
            state, np.vstack((unit, unit)), np.array([duration]), constants.as_array(), math.inf
        )[-1]
        columns.append((end[POSITION] - state[POSITION]) / duration)
    found: Vector = np.column_stack(columns)
    return found


def _speeds_along(
    state: Vector, direction: Vector, length: float, constants: LumpedConstants, probe: float
) -> tuple[Vector, Vector] | None:
    """Return places along a line [m] and the rotor speeds there for a speed of one [rad/m]."""
    speed = constants.shell_radius * constants.input_gain
    axis: Vector = np.array((-direction[1], direction[0]))
    longest = min(_STEP * constants.shell_radius, 0.5 * length)
    now, done, rolls = state, 0.0, False
    at, speeds = [0.0], []
    while True:
        if not rolls:
            matrix = velocities(now, constants, probe)
            left, values, right = np.linalg.svd(matrix)
            # Then the line is nearly the one along which the sphere rolls without a spin, by
            # constant speeds; V may become singular on it.
            tilt = rotation.matrix(now[QUATERNION])[:2, 2]
            least = float(np.linalg.norm(tilt))
            ratio = float(values[1] / values[0])
            off = _ROLLS if ratio > _SINGULAR else _ROLLS_SINGULAR
            rolls = least > _LEVEL and abs(float(tilt @ axis)) < off * least
            if rolls:
                along = right[0] * math.copysign(1.0, float(left[:, 0] @ direction)) / values[0]
            elif ratio > _REGULAR:
                along = np.linalg.solve(matrix, direction)
            else:
                return None
        factor = speed * float(np.linalg.norm(along))
        if not factor < _SLOWEST:
            return None
        speeds.append(along)
        if done >= length:
            return np.array(at), np.array(speeds)
        step = longest / max(1.0, factor)
        if not rolls:
            step *= min(1.0, max(_SINGULAR, ratio) / _EVEN)
        step = min(step, length - done)
        if length - done - step < 1e-9 * length:
            step = length - done
        middle = along
        if not rolls:
            half = _after(now, along, 0.5 * step, constants)
            middle = np.linalg.solve(velocities(half, constants, probe), direction)
        now = _after(now, middle, step, constants)
        done = length if step == length - done else done + step
        at.append(done)


def _after(state: Vector, speeds: Vector, duration: float, constants: LumpedConstants) -> Vector:
    inputs, durations = np.vstack((speeds, speeds)), np.array([duration])
    return roll_out(state, inputs, durations, constants.as_array(), math.inf)[-1]


def straight_hold(
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
        None where the sphere would nearly only spin.
    """
    limit, rate = solver.robot.max_rotor_speed, solver.robot.max_rotor_acceleration
    way = target - state[POSITION]
    length = float(np.linalg.norm(way))
    if length < 1e-6:
        return None
    probe = _PROBE * solver.grid.unit
    turn = _turn_in_place(state, way / length, constants, solver)
    if turn is not None:
        state = roll_out(state, turn.speeds, np.diff(turn.times), constants.as_array())[-1]
        way = target - state[POSITION]
        length = float(np.linalg.norm(way))
    found = _speeds_along(state, way / length, length, constants, probe)
    if found is None:
        return None
    at, speeds = found
    paces = _paces(at, speeds, limit, rate)
    reached = np.concatenate(([0.0], np.cumsum(2.0 * np.diff(at) / (paces[1:] + paces[:-1]))))
    end = float(reached[-1])
    for spacing in _SPACINGS:
        count = max(4, math.ceil(end / (spacing * solver.grid.fine)))
        times: Vector = np.linspace(0.0, end, count + 1, dtype=np.float64)
        knots = np.column_stack([
            np.interp(times, reached, paces * speeds[:, rotor]) for rotor in (0, 1)
        ])
        knots[0] = knots[-1] = 0.0
        line = FirstOrderHold(times, np.clip(knots, -limit, limit))
        there = roll_out(state, line.speeds, np.diff(times), constants.as_array())[-1, POSITION]
        if float(np.linalg.norm(there - target)) < _MISSED * constants.shell_radius:
            break
    return line if turn is None else joined([turn, line])


def joined(holds: list[FirstOrderHold]) -> FirstOrderHold:
    """Return holds from rest to rest one after the other, from time 0 on."""
    times, speeds = list[Vector]([np.zeros(1)]), list[Vector]([np.zeros((1, INPUT_SIZE))])
    end = 0.0
    for hold in holds:
        times.append(end + hold.times[1:] - hold.start)
        speeds.append(hold.speeds[1:])
        end = float(times[-1][-1])
    return FirstOrderHold(np.concatenate(times), np.vstack(speeds))


def _turn_in_place(
    state: Vector, direction: Vector, constants: LumpedConstants, solver: ArrivalSolver
) -> FirstOrderHold | None:
    """Return the turn about the vertical after which the sphere rolls along a direction.

    The sphere can do that where the body's z axis is horizontal; None where it is not, or no turn
    is needed.
    """
    left, values, right = np.linalg.svd(velocities(state, constants, _PROBE * solver.grid.unit))
    missing = math.atan2(
        float(left[0, 0] * direction[1] - left[1, 0] * direction[0]), float(left[:, 0] @ direction)
    )
    missing = math.remainder(missing, math.pi)
    if values[1] > _HORIZONTAL * values[0] or abs(missing) < _ROLLS:
        return None
    unit = right[1] / float(np.max(np.abs(right[1])))
    probe = _PROBE * solver.grid.unit
    turned = _after(state, unit, probe, constants)
    rate = rotation.logarithm(
        rotation.product(turned[QUATERNION], rotation.conjugate(state[QUATERNION]))
    )[2] / probe
    slope, area = solver.robot.max_rotor_acceleration, abs(missing / rate)
    ramp = min(solver.robot.ramp_time, math.sqrt(area / slope))
    speeds = math.copysign(slope * ramp, missing / rate) * unit
    times: Vector = np.array((0.0, ramp, area / (slope * ramp), area / (slope * ramp) + ramp))
    zero = np.zeros(INPUT_SIZE)
    if times[2] - times[1] < 1e-6:
        return FirstOrderHold(np.array((0.0, ramp, 2.0 * ramp)), np.array((zero, speeds, zero)))
    return FirstOrderHold(times, np.array((zero, speeds, speeds, zero)))


def _paces(at: Vector, speeds: Vector, limit: float, rate: float) -> Vector:
    """Return the speeds of the centre [m/s] at places on a line [m], from rest to rest.

    Both rotors keep the limits of their speeds [rad/s] and accelerations [rad/s^2].
    """
    steps = np.diff(at)
    largest = np.max(np.abs(speeds), axis=1)
    change = np.max(np.abs(np.diff(speeds, axis=0)), axis=1) / steps
    change = np.maximum(np.append(change, 0.0), np.append(0.0, change))
    squares = np.minimum(
        (limit / largest) ** 2, (1.0 - _RISING) * rate / np.maximum(change, 1e-12)
    )
    rises = 2.0 * steps * _RISING * rate / np.maximum(largest[1:], largest[:-1])
    squares[0] = squares[-1] = 0.0
    for k, rise in enumerate(rises):
        squares[k + 1] = min(squares[k + 1], squares[k] + rise)
    for k in range(rises.size - 1, -1, -1):
        squares[k] = min(squares[k], squares[k + 1] + rises[k])
    found: Vector = np.sqrt(squares)
    return found


def straight_arrival(
    situation: Situation, target: Vector, solver: ArrivalSolver
) -> Arrival | None:
    """Return the arrival of rolling straight to a place, with any orientation; see above."""
    hold = straight_hold(situation.state, target, situation.constants, solver)
    if hold is None:
        return None
    states = roll_out(
        situation.state, hold.speeds, np.diff(hold.times), situation.constants.as_array()
    )
    return Arrival(
        hold, states, states[-1, POSE].copy(), 0.0, 0, 0.0, len(states), situation.disturbance,
        orientation=Orientation.ANY,
    )
