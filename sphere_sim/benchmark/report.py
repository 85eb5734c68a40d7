# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Results of the benchmark as JSON content, as a table and as a figure."""

import contextlib
import os
import platform
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from sphere_nmpc.model.state import Vector
from sphere_sim.benchmark.closed_loops import SolverRecord
from sphere_sim.benchmark.solvers import ALGORITHM_1, OWN, PLAN_KEEPING

_COMPARED = ("median", "p99", "cpu_median", "cpu_p99")
_SHOWN_TIMES = ("median_ms", "p99_ms", "max_ms", "cpu_median_ms", "cpu_p99_ms")


def as_numbers(records: dict[str, SolverRecord], missing: dict[str, str]) -> dict[str, Any]:
    """Return the content of the JSON file."""
    solvers = {name: _solver_numbers(record) for name, record in records.items() if record.wall}
    report: dict[str, Any] = {"solvers": solvers, "missing": missing, "machine": _machine()}
    own = solvers.get(ALGORITHM_1)
    if own:
        report["times_algorithm_1"] = {
            name: {key: numbers[f"{key}_ms"] / own[f"{key}_ms"] for key in _COMPARED}
            for name, numbers in solvers.items()
            if name != ALGORITHM_1
        }
    kept = solvers.get(PLAN_KEEPING)
    if kept:
        report["control_rate_hz"] = {"p99": 1e3 / kept["p99_ms"], "max": 1e3 / kept["max_ms"]}
    return report


def _solver_numbers(record: SolverRecord) -> dict[str, Any]:
    wall, cpu = 1e3 * np.array(record.wall), 1e3 * np.array(record.cpu)
    return {
        **_spread("", wall),
        **_spread("cpu_", cpu),
        "settle_s": record.settle, "failures": record.failures, "solves": len(record.wall),
        "setup_s": record.setup_s, "stopped": record.stopped,
    }


def _spread(prefix: str, times: Vector) -> dict[str, float]:
    median, p99, most = np.percentile(times, [50.0, 99.0, 100.0])
    return {f"{prefix}median_ms": median, f"{prefix}p99_ms": p99, f"{prefix}max_ms": most}


def _machine() -> dict[str, Any]:
    model = platform.processor()
    with contextlib.suppress(OSError):
        found = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text("utf-8"))
        model = found.group(1).strip() if found else model
    return {
        "processor": model, "cores": os.cpu_count(), "python": platform.python_version(),
        "load_average": os.getloadavg()[0],
    }


def show(report: dict[str, Any], cases: Sequence[int], console: Console) -> None:
    """Print the table of all solvers and the other figures of the report."""
    table = Table(title="Closed loops on the paper's problem, time of a solve [ms]")
    table.add_column("solver")
    for name in ("median", "p99", "max", "CPU median", "CPU p99", "failures", "solves"):
        table.add_column(name, justify="right")
    table.add_column("settles, case " + " / ".join(map(str, cases)) + " [s]", justify="right")
    for name, row in report["solvers"].items():
        settle = " / ".join("never" if t is None else f"{t:.1f}" for t in row["settle_s"])
        table.add_row(
            name,
            *(f"{row[key]:.3f}" for key in _SHOWN_TIMES), str(row["failures"]),
            str(row["solves"]) + (" (stopped)" if row["stopped"] else ""), settle,
            style="bold" if name in OWN else "",
        )
    for name, reason in report["missing"].items():
        table.add_row(name, *["-"] * 7, reason, style="dim")
    console.print(table)
    rate = report.get("control_rate_hz")
    if rate:
        console.print(
            f"Control rate of {PLAN_KEEPING} on this machine: {rate['p99']:.0f} Hz at the 99th "
            f"percentile, {rate['max']:.0f} Hz at the slowest solve."
        )
    if "random" in report:
        _show_random(report["random"], console)


def _show_random(summary: dict[str, float], console: Console) -> None:
    kinds = sorted({key.partition("_not_worse")[0] for key in summary if "_not_worse" in key})
    for kind in kinds:
        console.print(
            f"Random problems ({summary['problems']:.0f}), {kind.replace('_', ' ')}: not worse "
            f"than IPOPT in {summary[f'{kind}_not_worse']:.1%}, better in "
            f"{summary[f'{kind}_better']:.1%}; median {summary[f'{kind}_median_ms']:.3f} ms."
        )


def draw(records: dict[str, SolverRecord], path: Path) -> None:
    """Draw the distribution of solve times as a PNG."""
    from matplotlib.figure import Figure

    shown = {name: record for name, record in records.items() if record.wall}
    figure = Figure(figsize=(8.0, 0.55 * len(shown) + 1.6), layout="constrained")
    axes, labels = figure.add_subplot(), []
    for row, (name, record) in enumerate(reversed(shown.items())):
        times = 1e3 * np.sort(record.wall)
        colour = "tab:orange" if name in OWN else "tab:blue"
        axes.plot(times, np.full(times.size, row), "|", color=colour, alpha=0.25, markersize=12)
        middle, late = np.percentile(times, [50.0, 99.0])
        for value, mark in ((middle, "o"), (late, ">")):
            axes.plot(value, row, mark, color=colour, markeredgecolor="black", markersize=8)
        labels.append(f"{name}\n{middle:.3g} / {late:.3g} ms")
    axes.set_yticks(range(len(shown)), labels)
    axes.set_xscale("log")
    axes.set_xlabel("wall time of a solve [ms]")
    figure.suptitle("Dot: median, triangle: 99th percentile, both beside the name", fontsize=10)
    axes.grid(axis="x", alpha=0.3)
    figure.savefig(path, dpi=150)
