# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Metrics of a run: errors over time, settling time, peaks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector

SETTLED_ERROR = 1e-2
"""A run is settled from the time on from which ||x - x_d|| stays below this [mixed units]."""


@dataclass(frozen=True)
class Metrics:
    """Metrics of a run; nan where the run does not determine a metric.

    Attributes
    ----------
    settled : bool
        Whether the error stays below `SETTLED_ERROR` from some time on to the end.
    settle_time_s : float
        That time, from the moment the goal was set [s].
    final_error : float
        ||x - x_d|| at the end [mixed units].
    final_position_error_m, final_orientation_error_rad : float
        Distance [m] and angle [rad] to the goal at the end.
    max_rotor_speed : float
        Largest magnitude [rad/s].
    max_rotor_torque_nm : float
        Largest magnitude [N m].
    solve_ms_p50, solve_ms_p99 : float
        Median and 99th percentile of the solve time [ms].
    """

    settled: bool
    settle_time_s: float
    final_error: float
    final_position_error_m: float
    final_orientation_error_rad: float
    max_rotor_speed: float
    max_rotor_torque_nm: float
    solve_ms_p50: float
    solve_ms_p99: float


def signed_differences(states: Vector, goals: Vector) -> Vector:
    """Return x - x_d with the nearer quaternion sign of the goal, shape (n, 6).

    Parameters
    ----------
    states : ndarray, shape (n, 6)
        States over time.
    goals : ndarray, shape (6,) or (n, 6)
        The goal, or the goal in force at each time.
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


def settling_index(errors: Vector, tolerance: float = SETTLED_ERROR) -> int | None:
    """Return the index from which on all errors are below `tolerance`; None if there is none."""
    outside = np.flatnonzero(~(errors < tolerance))
    first = int(outside[-1]) + 1 if outside.size else 0
    return first if first < errors.size else None


def measure(
    times: Vector,
    states: Vector,
    goal: Vector,
    rotor_speeds: Vector,
    rotor_torques: Vector,
    solve_times: Vector,
) -> Metrics:
    """Return the metrics of a run towards one goal.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Times since the goal was set [s], n > 0.
    states : ndarray, shape (n, 6)
        States at these times.
    goal : ndarray, shape (6,)
        The goal.
    rotor_speeds : ndarray, shape (m, 2)
        Rotor speeds at any times [rad/s].
    rotor_torques : ndarray, shape (m, 2)
        Rotor torques [N m].
    solve_times : ndarray, shape (k,)
        Solve times [s].

    Returns
    -------
    Metrics
    """
    errors = state_errors(states, goal)
    index = settling_index(errors)
    return Metrics(
        settled=index is not None,
        settle_time_s=float("nan") if index is None else float(times[index]),
        final_error=float(errors[-1]),
        final_position_error_m=float(position_errors(states[-1:], goal)[0]),
        final_orientation_error_rad=float(angle_errors(states[-1:], goal)[0]),
        max_rotor_speed=_peak(rotor_speeds),
        max_rotor_torque_nm=_peak(rotor_torques),
        solve_ms_p50=_percentile(solve_times, 50.0),
        solve_ms_p99=_percentile(solve_times, 99.0),
    )


def _peak(values: NDArray[np.float64]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.max(np.abs(finite))) if finite.size else float("nan")


def _percentile(solve_times: Vector, percent: float) -> float:
    finite = solve_times[np.isfinite(solve_times)]
    return 1e3 * float(np.percentile(finite, percent)) if finite.size else float("nan")
