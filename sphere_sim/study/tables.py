# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Results of a study: a table with a row a run, the rotor speeds of all runs, and a summary."""

import csv
import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import counted
from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.output.files import write_atomically
from sphere_sim.scenario.csv_file import MAP_COLUMN, PATH_COLUMN, SEED_COLUMN, STATE_COLUMNS
from sphere_sim.scenario.scenarios import (
    DISTURBANCE_COLUMNS,
    PATH_SPEED_COLUMN,
    PUSH_COLUMNS,
    Scenario,
)
from sphere_sim.study.journal import NotWrittenError
from sphere_sim.study.record import (
    FLOOR_RESULT_COLUMNS,
    ODOMETRY_RESULT_COLUMNS,
    PATH_RESULT_COLUMNS,
    PUSH_RESULT_COLUMNS,
    RESULT_COLUMNS,
    RunRecord,
    Value,
    finite,
)

KIND_COLUMN = "kind"
"""Column of scenario files by which a summary has scores."""
Results = Sequence[dict[str, Value]]
"""Results of each run by the names of `RESULT_COLUMNS`."""

_DISTRIBUTIONS = (
    "settle_time_s", "ratio", "final_error", "final_position_error_m",
    "final_orientation_error_rad", "loose_settle_time_s", "tail_error_p95",
)
_PEAKS = ("max_rotor_speed", "max_rotor_acceleration", "max_rotor_torque_nm")


def with_bounds(
    results: Results, lower_bounds: Sequence[float], best_known: Sequence[float] | None
) -> list[dict[str, Value]]:
    """Return the results with lower bound, best known settling time and ratio to it, if any.

    Lower bounds of the time [s] are nan where there is none. Best known are the settling times of
    the best known motions [s], from the push on if there was one; nan where no motion was found,
    0 where the start is at the goal.
    """
    known = [0.0] * len(results) if best_known is None else map(float, best_known)
    extended = []
    for found, bound, seconds in zip(results, lower_bounds, known, strict=True):
        added: dict[str, Value] = {"lower_bound_s": finite(bound)}
        if seconds > 0.0:
            added["bound_s"] = seconds
            settling = found.get("recover_s", found.get("settle_time_s"))
            if isinstance(settling, float):
                added["ratio"] = settling / seconds
        extended.append({**found, **added})
    return extended


def column(results: Results, name: str) -> Vector:
    """Return the numbers of a column in the order of the runs, missing ones left out."""
    values = (found.get(name) for found in results)
    return np.array([value for value in values if isinstance(value, (int, float))], dtype=float)


def summarise(scenarios: Sequence[Scenario], results: Results) -> dict[str, Any]:
    """Return the summary of a study as JSON content.

    Distributions are over the runs that have the quantity; ``failures`` lists each run that did
    not settle, ``timing`` holds all that depends on the machine.
    """
    further = [n for n in _further_columns(scenarios, results) if n not in FLOOR_RESULT_COLUMNS]
    return {
        "strategy": results[0]["strategy"],
        "runs": len(results),
        "settled": int(sum(bool(found["settled"]) for found in results)),
        "settled_error": SETTLED_ERROR,
        **{name: _distribution(column(results, name)) for name in _DISTRIBUTIONS},
        "beyond_lower_bound_s": _distribution(_beyond_lower_bound(results)),
        **{name: _distribution(column(results, name)) for name in further},
        **{name: _largest(column(results, name)) for name in _PEAKS},
        "failed_solves": int(np.sum(column(results, "failures"))),
        "crashed": sum(found.get("crash") is not None for found in results),
        "failures": [
            {
                "run": i,
                "seed": scenario.seed,
                "final_error": found.get("final_error"),
                "crash": found.get("crash"),
            }
            for i, (scenario, found) in enumerate(zip(scenarios, results, strict=True))
            if not found["settled"]
        ],
        **_contacts(results),
        "scores": scores(scenarios, results),
        "timing": {
            "solve_ms_p50": _distribution(column(results, "solve_ms_p50"))["median"],
            "solve_ms_p99": _largest(column(results, "solve_ms_p99")),
            "solve_ms_max": _largest(column(results, "solve_ms_max")),
        },
    }


def _further_columns(scenarios: Sequence[Scenario], results: Results) -> tuple[str, ...]:
    """Return the columns of pushes, paths, floors and an odometry, where the runs have these."""
    present = {name for found in results for name in found}
    return (
        *(PUSH_RESULT_COLUMNS if any(it.push is not None for it in scenarios) else ()),
        *(PATH_RESULT_COLUMNS if any(it.follows is not None for it in scenarios) else ()),
        *(FLOOR_RESULT_COLUMNS if FLOOR_RESULT_COLUMNS[0] in present else ()),
        *(ODOMETRY_RESULT_COLUMNS if ODOMETRY_RESULT_COLUMNS[0] in present else ()),
    )


def _contacts(results: Results) -> dict[str, Any]:
    """Return what a summary has of contacts with walls; nothing where there are no walls."""
    if not any("contacts" in found for found in results):
        return {}
    clearances = column(results, "least_clearance_m")
    return {
        "contacts": int(np.sum(column(results, "contacts"))),
        "least_clearance_m": float(np.min(clearances)) if clearances.size else None,
    }


def _beyond_lower_bound(results: Results) -> Vector:
    """Return settling time less lower bound [s] of the runs that have both."""
    pairs = ((found.get("settle_time_s"), found.get("lower_bound_s")) for found in results)
    return np.array(
        [time - bound for time, bound in pairs
         if isinstance(time, float) and isinstance(bound, float)]
    )


def scores(scenarios: Sequence[Scenario], results: Results) -> dict[str, dict[str, Any]]:
    """Return the scores of each kind in a column of the scenarios, and of all runs.

    That of a run is best known over settling time, at most 1; it is 0 for one that has not
    settled or has touched a wall. Without that column or best known times there are none.
    """
    kinds: dict[str, list[dict[str, Value]]] = {}
    for scenario, found in zip(scenarios, results, strict=True):
        if KIND_COLUMN in scenario.extra and "bound_s" in found:
            kinds.setdefault(scenario.extra[KIND_COLUMN], []).append(found)
    runs = [found for of_kind in kinds.values() for found in of_kind]
    return {kind: _score(of_kind) for kind, of_kind in (*kinds.items(), ("all", runs)) if of_kind}


def _score(results: Results) -> dict[str, Any]:
    clear = column([found for found in results if not found.get("contacts")], "ratio")
    return {
        "runs": len(results),
        "settled": sum(bool(found["settled"]) for found in results),
        "score": float(np.sum(1.0 / np.maximum(clear, 1.0))) / len(results),
        "ratio": _distribution(column(results, "ratio")),
        "contacts": int(np.sum(column(results, "contacts"))),
    }


def headline(summary: dict[str, Any]) -> str:
    """Return the summary as one line of text."""
    parts = [f"{summary['strategy']}: {summary['settled']} of {summary['runs']} settled"]
    settling, ratio = summary["settle_time_s"], summary["ratio"]
    if settling["count"]:
        parts.append(
            f"in {settling['median']:.2f} s median (p99 {settling['p99']:.2f}, "
            f"worst {settling['max']:.2f})"
        )
    if summary.get("recover_s", {}).get("count"):
        recovery = summary["recover_s"]
        parts.append(
            f"{recovery['median']:.2f} s after the push (p99 {recovery['p99']:.2f}, "
            f"worst {recovery['max']:.2f})"
        )
    if ratio["count"]:
        parts.append(f"{ratio['median']:.2f} x best known (p99 {ratio['p99']:.2f})")
    if summary.get("path_max_m", {}).get("count"):
        rms, largest = (1e3 * summary[name]["median"] for name in PATH_RESULT_COLUMNS[:2])
        worst = 1e3 * summary["path_max_m"]["max"]
        parts.append(f"path rms {rms:.1f} mm, largest {largest:.1f} mm (worst {worst:.1f})")
    if summary["final_error"]["count"]:
        parts.append(f"final error {summary['final_error']['median']:.1e}")
    if "contacts" in summary:
        parts.append(counted(int(summary["contacts"]), "contact"))
        if summary["least_clearance_m"] is not None:
            parts.append(f"least clearance {1e3 * summary['least_clearance_m']:.1f} mm")
    if ODOMETRY_RESULT_COLUMNS[0] in summary:
        far, turned = (summary[name]["median"] for name in ODOMETRY_RESULT_COLUMNS)
        parts.append(f"odometry {1e3 * far:.1f} mm and {turned:.2f} deg off")
    if summary["crashed"]:
        parts.append(f"{summary['crashed']} CRASHED")
    return ", ".join(parts)


def _distribution(values: Vector) -> dict[str, Any]:
    if not values.size:
        return {"count": 0, "median": None, "p90": None, "p99": None, "max": None}
    median, p90, p99 = np.percentile(values, [50.0, 90.0, 99.0]).tolist()
    return {
        "count": int(values.size),
        "median": median,
        "p90": p90,
        "p99": p99,
        "max": float(np.max(values)),
    }


def _largest(values: Vector) -> float | None:
    return float(np.max(values)) if values.size else None


def replace_file(path: Path, content: bytes | memoryview) -> None:
    """Replace a file; where that raises `NotWrittenError`, the previous one is kept."""
    try:
        write_atomically(path, content)
    except OSError as error:
        raise NotWrittenError(path, error) from None


def write_runs(
    path: Path, scenarios: Sequence[Scenario], results: Iterable[Results]
) -> None:
    """Write the table of all runs as CSV: the results of all scenarios for each strategy."""
    # A table of results may be the scenario file; its previous results are replaced.
    names = dict.fromkeys(name for scenario in scenarios for name in scenario.extra)
    results = list(results)
    further = _further_columns(scenarios, [found for it in results for found in it])
    result_names = RESULT_COLUMNS + further
    replaced = {*result_names, *PUSH_RESULT_COLUMNS, *PATH_RESULT_COLUMNS}
    extras = [name for name in names if name not in replaced]
    present = {name for scenario in scenarios for name in scenario.optional}
    numbers = (*PUSH_COLUMNS, *DISTURBANCE_COLUMNS, PATH_SPEED_COLUMN)
    optional = [PATH_COLUMN] * (PATH_RESULT_COLUMNS[0] in further)
    optional += [MAP_COLUMN] * any(it.map_file is not None for it in scenarios)
    optional += [name for name in numbers if name in present]
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow([*STATE_COLUMNS, SEED_COLUMN, *optional, *extras, *result_names])
    for of_strategy in results:
        for scenario, found in zip(scenarios, of_strategy, strict=True):
            values = np.concatenate((scenario.start, scenario.goal)).tolist()
            cells: list[Value] = [
                scenario.given.get(name, value)
                for name, value in zip(STATE_COLUMNS, values, strict=True)
            ]
            cells.append(scenario.seed)
            given: dict[str, Value] = {**scenario.optional}
            way = None if scenario.follows is None else scenario.follows.file
            for name, file in ((PATH_COLUMN, way), (MAP_COLUMN, scenario.map_file)):
                # From where the table is, as it is a scenario file itself.
                given[name] = None if file is None else os.path.relpath(file, path.parent)
            cells += [given.get(name) for name in optional]
            cells += [scenario.extra.get(name, "") for name in extras]
            cells += [found.get(name) for name in result_names]
            # Python writes the shortest text that reads back as the same number.
            writer.writerow(["" if cell is None else cell for cell in cells])
    replace_file(path, table.getvalue().encode())


def write_inputs(path: Path, records: Sequence[RunRecord]) -> None:
    """Write times ``t_i`` [s], shape (K,), and rotor speeds ``u_i`` [rad/s], (K, 2), of run i."""
    arrays: dict[str, Any] = {}
    for i, record in enumerate(records):
        arrays |= {f"t_{i}": record.times, f"u_{i}": record.speeds}
    archive = io.BytesIO()
    np.savez_compressed(archive, **arrays)
    replace_file(path, archive.getbuffer())
