# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The results of a demo as a table and as the content of ``summary.json``."""

import dataclasses
import math
from typing import Any

import numpy as np
from rich.table import Table

from sphere_nmpc import __version__
from sphere_sim.demo.plan import DemoPlan
from sphere_sim.evaluation.metrics import Metrics, settling_index, state_errors
from sphere_sim.recording.run import Run


def neighbourhood(run: Run, plan: DemoPlan) -> dict[str, float | None]:
    """Return the time of arrival within the plan's tolerance, and the error from then on.

    Returns
    -------
    dict of str to float or None
        `within_s` [s], and the largest error and its 95th percentile from then on; None where the
        run has not arrived.
    """
    errors = state_errors(run.states, plan.scenario.goal)
    index = settling_index(errors, plan.tolerance)
    if index is None:
        return {"within_s": None, "max_error_after": None, "p95_error_after": None}
    after = errors[index:]
    return {
        "within_s": float(run.times[index]),
        "max_error_after": float(np.max(after)),
        "p95_error_after": float(np.percentile(after, 95.0)),
    }


def summarise(plan: DemoPlan, arrived: bool, runs: dict[str, Run]) -> dict[str, Any]:
    """Return what goes into ``summary.json``.

    Parameters
    ----------
    plan : DemoPlan
        What was run.
    arrived : bool
        Whether the recorded run arrived at the goal.
    runs : dict of str to Run
        The recorded run under its strategy's name, then the computed one, if any.
    """
    recorded = runs[plan.strategy]
    return {
        "title": plan.title,
        "sphere_nmpc_version": __version__,
        "strategy": plan.strategy,
        "arrived": arrived,
        "tolerance": plan.tolerance,
        "start": plan.scenario.start.tolist(),
        "goal": plan.scenario.goal.tolist(),
        "seed": plan.scenario.seed,
        "simulator": plan.simulator,
        "controller": plan.controller,
        "metrics": _figures(recorded, plan),
        "compared_with": {
            name: _figures(run, plan) for name, run in runs.items() if run is not recorded
        },
        "duration_s": float(recorded.times[-1]),
        "notes": list(recorded.notes),
    }


def table(plan: DemoPlan, runs: dict[str, Run]) -> Table:
    """Return a table with one column per run; parameters as in `summarise`."""
    made = Table("result", *(f"{name}\n{_how(name, plan)}" for name in runs))
    columns = [_words(run, plan) for run in runs.values()]
    for rows in zip(*columns, strict=True):
        made.add_row(rows[0][0], *(value for _, value in rows))
    return made


def _how(name: str, plan: DemoPlan) -> str:
    return "recorded over ROS" if name == plan.strategy else "computed without ROS"


def _words(run: Run, plan: DemoPlan) -> list[tuple[str, str]]:
    metrics, near = _measured(run), neighbourhood(run, plan)
    settled = f"{metrics.settle_time_s:.2f} s" if metrics.settled else "not settled"
    rows = [("settling time (error < 1e-2)", settled)]
    if plan.disturbed:
        # Under noise the error does not settle below 1e-2, but it stays in a neighbourhood.
        since, usual, most = near["within_s"], near["p95_error_after"], near["max_error_after"]
        words = "not settled" if since is None else f"{since:.2f} s"
        rows = [(f"error < {plan.tolerance:g} from", words)]
        for name, value in (("95th percentile", usual), ("largest error", most)):
            rows.append((f"{name} from then on", "-" if value is None else f"{value:.3f}"))
    return [
        *rows,
        ("final error", f"{metrics.final_error:.2e}"),
        ("final distance", f"{1e3 * metrics.final_position_error_m:.2f} mm"),
        ("final angle", f"{math.degrees(metrics.final_orientation_error_rad):.3f} deg"),
        ("largest rotor speed", f"{metrics.max_rotor_speed:.1f} rad/s"),
        ("largest rotor torque", f"{metrics.max_rotor_torque_nm:.2f} N m"),
        ("solve time, median", f"{metrics.solve_ms_p50:.2f} ms"),
        ("solve time, p99", f"{metrics.solve_ms_p99:.2f} ms"),
    ]


def _figures(run: Run, plan: DemoPlan) -> dict[str, float | bool | None]:
    measured = dataclasses.asdict(_measured(run))
    return {key: _plain(value) for key, value in measured.items()} | neighbourhood(run, plan)


def _measured(run: Run) -> Metrics:
    metrics = run.metrics()
    if metrics is None:  # write_results has checked it
        raise ValueError(f"{run.name} holds no goal or no pose after it")
    return metrics


def _plain(value: float | bool) -> float | bool | None:
    """Return the value, or None for nan and infinity, which JSON lacks."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
