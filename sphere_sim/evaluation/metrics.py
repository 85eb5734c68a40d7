# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Metrics of a run: errors over time, when it has settled, deviations from paths, peaks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model import rotation
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, state_error
from sphere_nmpc.model.torque import heat_and_energy
from sphere_sim.evaluation.series import RobotSeries, Series

SETTLED_ERROR = 1e-2
"""A run is settled from the time on from which ||x - x_d|| stays below this [mixed units]."""
LOOSELY_SETTLED = 5e-2
"""Error below which a run with noise counts as settled: it does not stay below `SETTLED_ERROR`."""
ERRORS = ("error", "position_error_m", "angle_error_rad")
"""Errors to a goal: ||x - x_d|| [mixed units], distance [m] and angle [rad]."""


@dataclass(frozen=True)
class Metrics:
    """Metrics of a run; nan where the run does not determine a metric.

    Attributes
    ----------
    settled, settle_time_s : bool, float
        Whether the error stays below `SETTLED_ERROR` from some time on to the end, and that time
        from the moment the goal was set [s].
    final_error, final_position_error_m, final_orientation_error_rad : float
        ||x - x_d|| [mixed units], distance [m] and angle [rad] to the goal at the end; see
        `errors_to`.
    max_rotor_speed, max_rotor_torque_nm : float
        Largest magnitudes [rad/s], [N m].
    heat, energy_j : float
        Integrals of the motor torques squared [N^2 m^2 s] and of |torque times speed| [J].
    solve_ms_p50, solve_ms_p99 : float
        Median and 99th percentile of the solve time [ms], of the instants at which a plan was
        solved, rather than kept in 0 s.
    """

    settled: bool
    settle_time_s: float
    final_error: float
    final_position_error_m: float
    final_orientation_error_rad: float
    max_rotor_speed: float
    max_rotor_torque_nm: float
    heat: float
    energy_j: float
    solve_ms_p50: float
    solve_ms_p99: float


def signed_differences(states: Vector, goals: Vector) -> Vector:
    """Return x - x_d with the nearer quaternion sign of the goal, shape (n, 6).

    There is one goal, shape (6,), or one for each of the states, (n, 6).
    """
    goals = np.broadcast_to(goals, states.shape).copy()
    goals[:, QUATERNION] = rotation.nearer_sign(goals[:, QUATERNION], states[:, QUATERNION])
    return states - goals


def state_errors(states: Vector, goals: Vector) -> Vector:
    """Return ||x - x_d|| over time, shape (n,); arguments as in `signed_differences`."""
    return np.linalg.norm(signed_differences(states, goals), axis=1)


def position_errors(states: Vector, goals: Vector) -> Vector:
    """Return the distances to the goal [m], shape (n,)."""
    return np.linalg.norm(signed_differences(states, goals)[:, POSITION], axis=1)


def angle_errors(states: Vector, goals: Vector) -> Vector:
    """Return the angles to the goal's orientation [rad], shape (n,)."""
    return rotation.angle_between(states[:, QUATERNION], goals[..., QUATERNION])


def errors_to(goal: Goal, states: Vector) -> Vector:
    """Return the `ERRORS` of states, (n, 6), to the nearest poses that a goal allows, (n, 3).

    The angle is nan where the goal demands nothing of the orientation.
    """
    members = goal.orientation.nearest_of(goal.pose, states)
    of = state_errors, position_errors, angle_errors
    errors = [of_one(states, members) for of_one in of]
    if goal.orientation is Orientation.ANY:
        errors[2] = np.full(len(states), np.nan)
    return np.stack(errors, axis=1)


def estimate_errors(estimates: Series, poses: Series) -> Vector:
    """Return the errors of estimated poses: distance [m] and heading [rad], shape (m, 2).

    The true poses have quaternions that do not change their sign from one to the next; they are
    interpolated, and errors outside of them are nan. The error of the heading is the vertical
    component of the rotation vector that turns the true orientation into the estimated one, in the
    world frame.
    """
    true = poses.interpolated(estimates.times, math.nan)
    turns = rotation.products(
        estimates.values[:, QUATERNION].T, rotation.conjugate(true[:, QUATERNION]).T
    ).T
    headings = np.array([rotation.logarithm(turn)[2] for turn in turns])
    return np.column_stack((position_errors(estimates.values, true), headings))


def settling_index(errors: Vector, tolerance: float = SETTLED_ERROR) -> int | None:
    """Return the index from which on all errors are below `tolerance`; None if there is none."""
    outside = np.flatnonzero(~(errors < tolerance))
    first = int(outside[-1]) + 1 if outside.size else 0
    return first if first < errors.size else None


@dataclass(frozen=True)
class Stay:
    """Time from which errors stay below a tolerance [s], and how large they are from then on."""

    since: float
    p95: float  # 95th percentile [mixed units]
    largest: float


def stay_below(times: Vector, errors: Vector, tolerance: float = SETTLED_ERROR) -> Stay | None:
    """Return from when on a run has settled within a tolerance; None if it has not."""
    index = settling_index(errors, tolerance)
    if index is None:
        return None
    after = errors[index:]
    return Stay(float(times[index]), float(np.percentile(after, 95.0)), float(np.max(after)))


class GoalRun:
    """A run to one goal, shape (6,), while it lasts.

    It has settled once its error has stayed below a tolerance [mixed units] for `hold` [s].
    """

    def __init__(
        self, goal: Vector, tolerance: float = SETTLED_ERROR, hold: float = 1.0
    ) -> None:
        self.goal = goal
        self.tolerance = tolerance
        self.time = math.nan
        """Time of the newest state [s]."""
        self.state: Vector = np.full(goal.shape, math.nan)
        """The newest state."""
        self.error = math.nan
        """Error ||x - x_d|| [mixed units]."""
        self._hold = hold
        self._inside_since: float | None = None

    def observe(self, time: float, state: Vector) -> None:
        """Take a state, shape (6,), at a time [s]."""
        self.time, self.state = time, state
        self.error = state_error(state, self.goal)
        if not self.error < self.tolerance:
            self._inside_since = None
        elif self._inside_since is None:
            self._inside_since = time

    def settled_at(self, not_before: float = -math.inf) -> float | None:
        """Return the time at which the sphere reached the goal [s], once it has stayed there.

        None until then. Its stay counts from the time `not_before` [s] on.
        """
        since = self._inside_since
        if since is None or self.time < max(since, not_before) + self._hold:
            return None
        return since


def measure(run: RobotSeries, goal: Goal, solve_times: Vector) -> Metrics:
    """Return the metrics of a run towards one goal that does not move.

    Times are those since the goal was set; the solve times [s], (k,), are in any order.
    """
    speeds, torques = run.rotor_speeds.values, run.rotor_torques.values
    heat, energy = heat_and_energy(
        np.diff(run.rotor_speeds.times), speeds, torques[:-1], torques[1:]
    ).tolist()
    errors = errors_to(goal, run.states)
    stay = stay_below(run.times, errors[:, 0])
    final_error, final_distance, final_angle = errors[-1].tolist()
    return Metrics(
        settled=stay is not None, settle_time_s=math.nan if stay is None else stay.since,
        final_error=final_error, final_position_error_m=final_distance,
        final_orientation_error_rad=final_angle,
        max_rotor_speed=_peak(speeds), max_rotor_torque_nm=_peak(torques),
        heat=heat, energy_j=energy,
        solve_ms_p50=_percentile(solve_times, 50.0), solve_ms_p99=_percentile(solve_times, 99.0),
    )


def _peak(values: NDArray[np.float64]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.max(np.abs(finite))) if finite.size else math.nan


def _percentile(solve_times: Vector, percent: float) -> float:
    solved = solve_times[np.isfinite(solve_times) & (solve_times > 0.0)]
    return 1e3 * float(np.percentile(solved, percent)) if solved.size else math.nan


def deviations(paths: Sequence[Path], places: Vector, reach: float) -> tuple[Vector, Vector]:
    """Return the distances from paths followed in order, and the lengths followed [m].

    Both are of all places, shape (N, 2). The length changes by up to `reach` [m] from one to the
    next, so that parts of a path that come near one another do not stand for one another. A path
    is left, within the tolerance of its end, where the next one is as near.
    """
    index, way, before = 0, 0.0, 0.0
    found = []
    for place in places:
        path = paths[index]
        way = path.nearest(place, way - reach, way + reach)
        away = _distance(path, way, place)
        if index + 1 < len(paths) and way > path.length - path.tolerance:
            then = paths[index + 1].nearest(place, 0.0, reach)
            other = _distance(paths[index + 1], then, place)
            if other <= away:
                index, before, way, away = index + 1, before + path.length, then, other
        found.append((away, before + way))
    distances, ways = np.array(found).T
    return distances, ways


def _distance(path: Path, way: float, place: Vector) -> float:
    return math.hypot(*(path.at(way)[:2] - place))


def measure_along(
    times: Vector, places: Vector, paths: Sequence[Path], reach: float
) -> tuple[float, float, float]:
    """Return how far a run along paths deviates and how long it takes; nan if it never does.

    It is judged from when it is first on the path, within the tolerance, until it stays at the
    end, to `SETTLED_ERROR`, having followed all of the rest; otherwise to the last of the times.

    Returns
    -------
    rms, largest : float
        Root of the mean square over time and largest distance [m]; see `deviations`.
    duration : float
        How long it takes [s]; nan where it does not come to the end.
    """
    away, ways = deviations(paths, places, reach)
    near = away <= paths[0].tolerance
    if not near.any():
        return math.nan, math.nan, math.nan
    first, last = int(np.argmax(near)), len(places)
    whole = ways > sum(path.length for path in paths) - SETTLED_ERROR
    since = settling_index(np.linalg.norm(places - paths[-1].places[-1], axis=1))
    duration = math.nan
    if since is not None and whole[-1]:
        last = max(since, int(np.argmax(whole)))
        duration = float(times[last] - times[first])
    away = away[first : last + 1]
    return float(np.sqrt(np.mean(away**2))), float(np.max(away)), duration


def touches(clearances: Vector) -> NDArray[np.intp]:
    """Return the indices at which touches begin, of the clearances at all poses [m], shape (n,).

    A sphere touches where its clearance is 0 or less; nan is no touch.
    """
    touching = clearances <= 0.0
    return np.flatnonzero(touching & ~np.concatenate(([False], touching[:-1])))
