# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is kept of a run."""

import json
import math
from dataclasses import dataclass
from typing import Any

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


@dataclass(frozen=True)
class RunRecord:
    """A run that was made.

    Attributes
    ----------
    results : dict of str to Value
        By the names of `RESULT_COLUMNS`, apart from what compares runs with the bound.
    times : tuple of float
        Knots of the rotor speeds [s]; empty for a run that crashed.
    speeds : tuple of (float, float)
        Rotor speeds there [rad/s].
    """

    results: dict[str, Value]
    times: tuple[float, ...] = ()
    speeds: tuple[tuple[float, float], ...] = ()

    def as_json(self, index: int) -> str:
        """Return the record of run `index` as one line."""
        content = {"run": index, "results": self.results, "t": self.times, "u": self.speeds}
        return json.dumps(content, allow_nan=False)

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
            knots = tuple((float(a), float(b)) for a, b in content["u"])
            return int(content["run"]), cls(content["results"], tuple(content["t"]), knots)
        except (KeyError, TypeError) as error:
            raise ValueError(f"not the record of a run: {error}") from None


def finite(value: Any) -> Value:
    """Return the value, None in place of a number that is not finite."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    result: Value = value
    return result
