# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of a run for other tools, as CSV or Parquet."""

import io
from pathlib import Path

import numpy as np

from sphere_nmpc.model.state import STATE_NAMES, Vector
from sphere_sim.evaluation.metrics import angle_errors, position_errors, state_errors
from sphere_sim.output.files import write_atomically
from sphere_sim.recording.run import Run
from sphere_sim.report.reported import COLUMNS, Reported


def motion_table(run: Run) -> dict[str, Vector]:
    """Return the columns of a table with one row for each pose.

    Parameters
    ----------
    run : Run
        The run.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Times [s], states [m, -], errors, and rotor speeds [rad/s] and torques [N m] interpolated
        at the poses; nan where not recorded.
    """
    table = {"time_s": run.times}
    table.update({name: run.states[:, i] for i, name in enumerate(STATE_NAMES)})
    goals = run.goals_in_force
    table["error"] = state_errors(run.states, goals)
    table["position_error_m"] = position_errors(run.states, goals)
    table["angle_error_rad"] = angle_errors(run.states, goals)
    for name, unit, values in (
        ("rotor_speed", "rad_s", run.rotor_speeds),
        ("rotor_torque", "nm", run.rotor_torques),
    ):
        for i in range(2):
            column = _interpolate(run.times, run.joint_times, values[:, i])
            table[f"{name}_{i + 1}_{unit}"] = column
    return table


def solve_table(run: Run) -> dict[str, Vector]:
    """Return the columns of a table with one row for each solve: times, durations [s], values."""
    solves = run.solves
    return {"time_s": solves.times, "solve_time_s": solves.durations, "cost": solves.costs}


def goal_table(one: Reported) -> dict[str, Vector]:
    """Return the columns of a table with one row for each goal; see `COLUMNS`."""
    rows = [values for values, _ in one.rows()]
    return {name: np.array([row[name] for row in rows], dtype=float) for name in COLUMNS}


def write_csv(table: dict[str, Vector], path: Path) -> None:
    """Write a table with a header line, exact to the last bit."""
    rows = np.column_stack(list(table.values()))
    text = io.StringIO()
    np.savetxt(text, rows, fmt="%.17g", delimiter=",", header=",".join(table), comments="")
    write_atomically(path, text.getvalue())


def write_parquet(table: dict[str, Vector], path: Path) -> None:
    """Write a table as Parquet."""
    # pyarrow is an optional dependency.
    import pyarrow as pa
    import pyarrow.parquet as pq

    packed = io.BytesIO()
    pq.write_table(pa.table(table), packed)
    write_atomically(path, packed.getvalue())


def _interpolate(times: Vector, sampled: Vector, values: Vector) -> Vector:
    """Return values at other times by linear interpolation; nan outside of the samples."""
    if not sampled.size:
        return np.full_like(times, np.nan)
    return np.interp(times, sampled, values, left=np.nan, right=np.nan)
