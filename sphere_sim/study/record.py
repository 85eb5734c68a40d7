# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Record of a run: its results and rotor speeds."""

import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_sim.evaluation.closed_loop import AT_PUSH_SIZE

Value = bool | int | float | str | None
"""Content of a table cell; None where the run has no such result."""

RESULT_COLUMNS = (
    "strategy", "settled", "settle_time_s", "final_error", "final_position_error_m",
    "final_orientation_error_rad", "max_rotor_speed", "max_rotor_acceleration",
    "max_rotor_torque_nm", "heat", "energy_j", "solve_ms_p50", "solve_ms_p99", "solve_ms_max",
    "lower_bound_s", "bound_s", "ratio", "failures", "last_failure", "loose_settle_time_s",
    "tail_error_p95", "stability_steps", "stability_violations", "crash",
)
"""Columns of runs.csv with results, in order; ``solve_ms_...`` depend on the machine's load."""
PUSH_RESULT_COLUMNS = ("recover_s",)
"""Further columns of runs.csv of a study with pushes."""
PATH_RESULT_COLUMNS = ("path_rms_m", "path_max_m", "path_time_s")
"""Further columns of runs.csv of a study with paths; see `evaluation.metrics.measure_along`."""
FLOOR_RESULT_COLUMNS = ("contacts", "least_clearance_m", "reason")
"""Further columns of runs.csv of a study on a floor; ``reason`` is why a goal was given up."""

ODOMETRY_RESULT_COLUMNS = ("odometry_position_error_m", "odometry_heading_error_deg")
"""Further columns of runs.csv of a study on the poses of an odometry: its errors at the end."""


@dataclass(frozen=True, eq=False)
class RunRecord:
    """Results of one run.

    Attributes
    ----------
    results : dict of str to Value
        By their columns, without those that compare with the lower bound and the best known time.
    times : ndarray, shape (K,)
        Knot times of the rotor speeds [s]; empty for a run that crashed.
    speeds : ndarray, shape (K, 2)
        Rotor speeds at the knots [rad/s].
    at_push : ndarray, shape (11,) or (0,)
        As in `sphere_sim.evaluation.closed_loop.Trajectory`.
    """

    results: dict[str, Value]
    times: Vector = field(default_factory=lambda: np.empty(0))
    speeds: Vector = field(default_factory=lambda: np.empty((0, INPUT_SIZE)))
    at_push: Vector = field(default_factory=lambda: np.empty(0))

    def as_json(self, index: int) -> str:
        """Return the record of run `index` as one line."""
        knots = {"t": self.times.tolist(), "u": self.speeds.tolist()}
        if self.at_push.size:
            knots["push"] = self.at_push.tolist()
        return json.dumps({"run": index, "results": self.results, **knots}, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> tuple[int, "RunRecord"]:
        """Return the number of a run and its record; ValueError for no line of `as_json`."""
        try:
            content = json.loads(line)
            index, results = content["run"], content["results"]
            times, speeds = (_numbers(content[name]) for name in "tu")
            at_push = _numbers(content.get("push", []))
            speeds = speeds if speeds.size else speeds.reshape(0, INPUT_SIZE)
            valid = times.ndim == 1 and speeds.shape == (times.size, INPUT_SIZE)
            valid = valid and at_push.shape in ((0,), (AT_PUSH_SIZE,))
            valid = valid and type(index) is int and {"strategy", "settled"} <= results.keys()
            valid = valid and all(map(_is_valid, results, results.values()))
        except (KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(f"not the record of a run: {error}") from None
        if not valid:
            raise ValueError("not the record of a run")
        return index, cls(results, times, speeds, at_push)


def _numbers(content: Any) -> Vector:
    """Return a list as an array; ValueError if all of it is not finite numbers."""
    array = np.asarray(content)
    if array.size and (array.dtype.kind not in "iuf" or not np.all(np.isfinite(array))):
        raise ValueError("not the record of a run: not numbers")
    return array.astype(float)


def _is_valid(name: str, value: Any) -> bool:
    """Return whether a result has the type of its column."""
    if name == "settled":
        return isinstance(value, bool)
    if name in ("strategy", "crash"):
        return isinstance(value, str)
    if name in ("reason", "last_failure"):
        return value is None or isinstance(value, str)
    return value is None or (type(value) in (int, float) and math.isfinite(value))


def finite(value: Any) -> Value:
    """Return the value, or None for a number that is not finite."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    result: Value = value
    return result
