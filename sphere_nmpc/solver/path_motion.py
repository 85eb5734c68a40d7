# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Fastest motion of a sphere without momentum along a path.

The nominal motion follows the path by the law of `sphere_nmpc.solver.path_law`, in steps by which
the rotor speeds of the law change little. As the motion depends on the angles of the rotors alone,
its pace is free: for the squared rate x = (d tau / d t)^2 at each of its times tau, the limits of
the rotors' speeds and of the centre's bound x, and those of their accelerations,

    |(3 u' - u) x' - (3 u - u') x| <= 4 a (tau' - tau),

are linear in x and in x' at the next time. A pass from the end, where the sphere rests, finds the
largest x from which the limits can be kept, and a pass from the start the fastest motion (Pham and
Pham, IEEE Transactions on Robotics 34, 2018).
"""

import math
import threading
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import POSE, QUATERNION, Vector
from sphere_nmpc.solver.native.library import library

_MAX_STEP, _MIN_STEP, _MAX_SPEED_CHANGE, _END_DISTANCE = 0.02, 1.5e-4, 0.17, 3e-3
"""Longest and shortest step of the nominal motion [Rs], change of the rotors' speeds [over c1] by
one, distance from the end of the path at which it ends [Rs]."""
_MAX_ANGLE_ERROR = 1e-4
"""Angle by which the shell may turn less or more between two knots [rad]."""
_MAX_STEPS = 3000
"""Steps at most."""
_FIELDS = 9
_WORKSPACES = threading.local()


class PathLimits(NamedTuple):
    """Limits of a motion along a path.

    Attributes
    ----------
    speed, acceleration : float
        Of the rotors [rad/s, rad/s^2].
    pace : float
        Of the centre [m/s].
    """

    speed: float
    acceleration: float
    pace: float


@dataclass(frozen=True, eq=False)
class PathProblem:
    """Motion along a path that is sought.

    Attributes
    ----------
    path : Path
        The path.
    way, last : float
        Lengths [m] at which it begins, and at which it rests at the latest.
    state : ndarray, shape (6,) or more
        Pose at the start.
    speeds : ndarray, shape (2,)
        Speeds of the rotors at the start [rad/s]. What the motion does not begin with is lost by
        half of the acceleration, as far as the limits leave it.
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    limits : PathLimits
        Limits.
    turn : float
        C of the law: on a straight line the motion has it after each crossing of Gamma.
    """

    path: Path
    way: float
    last: float
    state: Vector
    speeds: Vector
    constants: Vector
    limits: PathLimits
    turn: float = 0.0


class PathMotion(NamedTuple):
    """Motion along a path.

    Attributes
    ----------
    times : ndarray, shape (K,)
        Of the knots, from 0 [s].
    speeds : ndarray, shape (K, 2)
        Of the rotors at the knots [rad/s], at rest at the end.
    ways : ndarray, shape (K,)
        Lengths of the path at the knots [m].
    jump : float
        By how much the speeds at the start differ from those of the fastest motion [rad/s].
    """

    times: Vector
    speeds: Vector
    ways: Vector
    jump: float


def along_path(problem: PathProblem) -> PathMotion:
    """Return the fastest motion along a path; safe to call from several threads."""
    solver, path, limits = library(), problem.path, problem.limits
    if solver is None:
        return _plain(problem)
    if not hasattr(_WORKSPACES, "steps"):
        _WORKSPACES.steps = np.empty((_MAX_STEPS, _FIELDS))
        _WORKSPACES.knots = np.empty((_MAX_STEPS, 5))
    knots: Vector = _WORKSPACES.knots
    # Named, so that they live until the call has ended.
    arrays = (
        path.curve, problem.constants, np.array(limits), np.ascontiguousarray(problem.state[POSE]),
        np.ascontiguousarray(problem.speeds),
    )
    found = solver.hold_along_path(
        len(path.curve), path.spacing, path.tolerance, problem.turn, problem.way, problem.last,
        *(array.ctypes.data for array in arrays), _MAX_STEPS,
        _WORKSPACES.steps.ctypes.data, knots.ctypes.data,
    )
    return _motion(knots[:found])


def _motion(knots: Vector) -> PathMotion:
    times, speeds, ways = (knots[:, part].copy() for part in (0, slice(1, 3), 3))
    return PathMotion(times, speeds, ways, float(knots[0, 4]))


def _plain(problem: PathProblem) -> PathMotion:
    """Do what `along_path` does, on CasADi and NumPy."""
    taus, laws, ways = _nominal(problem)
    speeds = laws[:, :2]
    rates, times = _fastest(problem, taus, laws)
    jump = problem.speeds - rates[0] * speeds[0]
    lost = max(2.0 * float(np.max(np.abs(jump))) / problem.limits.acceleration, 1e-9)
    speeds = rates[:, None] * speeds + np.maximum(0.0, 1.0 - times / lost)[:, None] * jump
    speeds = np.clip(speeds, -problem.limits.speed, problem.limits.speed)
    for k, reach in enumerate(problem.limits.acceleration * np.diff(times)):
        speeds[k + 1] = np.clip(speeds[k + 1], speeds[k] - reach, speeds[k] + reach)
    if len(times) > 1:  # what has not been lost by the end is lost in a longer last step
        times[-1] += float(np.max(np.abs(speeds[-1]))) / problem.limits.acceleration
        speeds[-1] = 0.0
    kept = [0]
    for k in range(1, len(times)):
        part = slice(kept[-1], k + 2)
        shares = (times[part] - times[part][0])[:, None] / (times[part][-1] - times[part][0])
        off = speeds[part] - (1.0 - shares) * speeds[part][0] - shares * speeds[part][-1]
        turned = float(np.max(np.abs(off))) * problem.constants[1] * np.ptp(times[part])
        if k == len(times) - 1 or turned > _MAX_ANGLE_ERROR:
            kept.append(k)
    jumps = np.full(len(times), np.max(np.abs(jump)))
    return _motion(np.column_stack((times, speeds, ways, jumps))[kept])


def _nominal(problem: PathProblem) -> tuple[Vector, Vector, Vector]:
    """Return times, laws and ways of the nominal motion."""
    path, radius = problem.path, float(problem.constants[0])
    change, end = _MAX_SPEED_CHANGE / float(problem.constants[1]), path.places[-1]
    pose, way = problem.state[POSE].copy(), problem.way

    def law(way: float, pose: Vector) -> Vector:
        given = problem.turn, way < path.length, path.tolerance
        return _law(pose, path.at(way), np.array(given), problem.constants)

    step, tau = _MAX_STEP, 0.0
    bend: Vector = np.zeros(2)
    here = law(way, pose)
    rows = [(tau, way)]
    laws = [here]
    last = problem.last if problem.last < path.length else math.inf
    while len(rows) < _MAX_STEPS and way < last:
        if way >= path.length and math.hypot(*(end - pose[:2])) < _END_DISTANCE * radius:
            break
        step = min(2.0 * step, _MAX_STEP)
        while True:
            # Where the speeds go on to change as they did, or else not at all.
            predicted = _moved(pose, here, here[:2] + step * bend, step, problem.constants)
            ahead = min(way + radius * step * here[2], path.length)
            following = law(ahead, predicted)
            if not np.max(np.abs(following[:2] - here[:2])) > change or step < _MIN_STEP:
                break
            step, bend = 0.5 * step, np.zeros(2)
        pose, tau = _moved(pose, here, following, step, problem.constants), tau + step
        bend, way = (following[:2] - here[:2]) / step, ahead
        here = following
        rows.append((tau, way))
        laws.append(here)
    taus, ways = np.array(rows).T
    return taus, np.array(laws), ways


def _fastest(problem: PathProblem, taus: Vector, laws: Vector) -> tuple[Vector, Vector]:
    """Return the largest rates and the times of a nominal motion."""
    limits, radius, count = problem.limits, float(problem.constants[0]), len(taus)
    speeds, steps = laws[:, :2], np.diff(taus)
    squares = np.minimum(
        limits.speed / np.maximum(np.max(np.abs(speeds), axis=1), 1e-6),
        limits.pace / (radius * np.maximum(laws[:, 3], 1e-9)),
    ) ** 2
    squares[-1] = 0.0
    a, b = 3.0 * speeds[1:] - speeds[:-1], 3.0 * speeds[:-1] - speeds[1:]
    a, b = np.abs(a), np.where(a < 0.0, -b, b)
    bounds = 4.0 * limits.acceleration * steps
    for k in range(count - 2, -1, -1):
        x, bound = float(squares[k]), float(bounds[k])
        for i in (0, 1):
            if b[k, i] * x > squares[k + 1] * a[k, i] + bound:
                x = (squares[k + 1] * a[k, i] + bound) / b[k, i]
            if -b[k, i] * x > bound:
                x = -bound / b[k, i]
            slope = b[k, i] * a[k, 1 - i] - b[k, 1 - i] * a[k, i]
            if slope * x > bound * (a[k, 0] + a[k, 1]):
                x = bound * (a[k, 0] + a[k, 1]) / slope
        squares[k] = x
    first = speeds[0]
    rate = max(0.0, float(first @ problem.speeds) / max(float(first @ first), 1e-12))
    squares[0], times = min(squares[0], rate**2), np.zeros(count)
    for k in range(count - 1):
        x = float(squares[k + 1])
        for i in (0, 1):
            if a[k, i] * x > b[k, i] * squares[k] + bounds[k]:
                x = (b[k, i] * squares[k] + bounds[k]) / a[k, i]
        squares[k + 1] = max(x, 0.0)
        mean = 0.5 * (math.sqrt(squares[k]) + math.sqrt(squares[k + 1]))
        times[k + 1] = times[k] + steps[k] / max(mean, 5e-7)
    return np.sqrt(squares), times


@cache
def _functions() -> tuple[Any, Any]:
    from sphere_nmpc.model.integrator import step_function
    from sphere_nmpc.solver.path_law import path_law_function

    return path_law_function(), step_function()


def _law(pose: Vector, point: Vector, given: Vector, constants: Vector) -> Vector:
    found = _functions()[0](pose[QUATERNION], pose[:2], point, given, constants)
    return np.asarray(found).ravel()


def _moved(pose: Vector, here: Vector, after: Vector, step: float, constants: Vector) -> Vector:
    return np.asarray(_functions()[1](pose, here[:2], after[:2], step, constants)).ravel()
