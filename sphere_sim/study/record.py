# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is kept of a run."""

import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector

Value = bool | int | float | str | None
"""Content of a cell; None where there is nothing to say."""

RESULT_COLUMNS = (
    "strategy",
    "settled",
    "settle_time_s",
    "final_error",
    "final_position_error_m",
    "final_orientation_error_rad",
    "max_rotor_speed",
    "max_rotor_acceleration",
    "max_rotor_torque_nm",
    "solve_ms_p50",
    "solve_ms_p99",
    "solve_ms_max",
    "bound_s",
    "ratio",
    "failures",
    "loose_settle_time_s",
    "tail_error_p95",
    "stability_steps",
    "stability_violations",
    "crash",
)
"""Columns of runs.csv that a run fills, in order."""

TIMING_COLUMNS = ("solve_ms_p50", "solve_ms_p99", "solve_ms_max")
"""Those that depend on the machine and its load; all others do not."""


@dataclass(frozen=True, eq=False)
class RunRecord:
    """A run that was made.

    Attributes
    ----------
    results : dict of str to Value
        By the names of `RESULT_COLUMNS`, apart from what compares runs with the bound.
    times : ndarray, shape (K,)
        Knots of the rotor speeds [s]; empty for a run that crashed.
    speeds : ndarray, shape (K, 2)
        Rotor speeds there [rad/s].
    """

    results: dict[str, Value]
    times: Vector = field(default_factory=lambda: np.empty(0))
    speeds: Vector = field(default_factory=lambda: np.empty((0, INPUT_SIZE)))

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, RunRecord)
            and self.results == other.results
            and np.array_equal(self.times, other.times)
            and np.array_equal(self.speeds, other.speeds)
        )

    def as_json(self, index: int) -> str:
        """Return the record of run `index` as one line."""
        knots = {"t": self.times.tolist(), "u": self.speeds.tolist()}
        return json.dumps({"run": index, "results": self.results, **knots}, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> tuple[int, "RunRecord"]:
        """Return the number of a run and its record.

        Raises
        ------
        ValueError
            If the line is not what `as_json` writes, for instance cut short.
        """
        try:
            content = json.loads(line)
            index, results = content["run"], content["results"]
            times, speeds = (_numbers(content[name]) for name in "tu")
            speeds = speeds if speeds.size else speeds.reshape(0, INPUT_SIZE)
            sound = times.ndim == 1 and speeds.shape == (times.size, INPUT_SIZE)
            sound = sound and type(index) is int and {"strategy", "settled"} <= results.keys()
            sound = sound and all(map(_is_sound, results, results.values()))
        except (KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(f"not the record of a run: {error}") from None
        if not sound:
            raise ValueError("not the record of a run")
        return index, cls(results, times, speeds)


def _numbers(content: Any) -> Vector:
    """Return a list as an array; ValueError if all of it is not finite numbers."""
    array = np.asarray(content)
    if array.size and (array.dtype.kind not in "iuf" or not np.all(np.isfinite(array))):
        raise ValueError("not the record of a run: not numbers")
    return array.astype(float)


def _is_sound(name: str, value: Any) -> bool:
    """Tell whether a result is of its kind."""
    if name == "settled":
        return isinstance(value, bool)
    if name in ("strategy", "crash"):
        return isinstance(value, str)
    return value is None or (type(value) in (int, float) and math.isfinite(value))


def finite(value: Any) -> Value:
    """Return the value, None in place of a number that is not finite."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    result: Value = value
    return result
