# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A run's series as tables for other tools."""

import io
from pathlib import Path

import numpy as np

from sphere_nmpc.model.state import STATE_NAMES, Vector
from sphere_sim.evaluation.metrics import angle_errors, position_errors, state_errors
from sphere_sim.output.atomic_write import write_atomically
from sphere_sim.recording.run import Run


def motion_table(run: Run) -> dict[str, Vector]:
    """Return one column a quantity, one row a pose; joint states are joined on in between.

    Parameters
    ----------
    run : Run
        The run.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Times [s], states [m, -], errors, rotor speeds [rad/s] and torques [N m]; nan where the
        bag does not tell.
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
            table[f"{name}_{i + 1}_{unit}"] = _at(run.times, run.joint_times, values[:, i])
    return table


def solve_table(run: Run) -> dict[str, Vector]:
    """Return times [s], durations [s] and values of the solves, one row each."""
    solves = run.solves
    return {"time_s": solves.times, "solve_time_s": solves.durations, "cost": solves.costs}


def write_csv(table: dict[str, Vector], path: Path) -> None:
    """Write a table with a header line, in digits that lose nothing."""
    rows = np.column_stack(list(table.values()))
    text = io.StringIO()
    np.savetxt(text, rows, fmt="%.17g", delimiter=",", header=",".join(table), comments="")
    write_atomically(path, text.getvalue())


def write_parquet(table: dict[str, Vector], path: Path) -> None:
    """Write a table as Parquet."""
    # Only those who ask for it need pyarrow.
    import pyarrow as pa
    import pyarrow.parquet as pq

    packed = io.BytesIO()
    pq.write_table(pa.table(table), packed)
    write_atomically(path, packed.getvalue())


def _at(times: Vector, sampled: Vector, values: Vector) -> Vector:
    """Return values at other times by linear interpolation, nan outside of the samples."""
    if not sampled.size:
        return np.full_like(times, np.nan)
    return np.interp(times, sampled, values, left=np.nan, right=np.nan)
