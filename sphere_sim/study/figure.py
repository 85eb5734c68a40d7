# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a study on one page."""

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import LARGEST
from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.output.colours import SERIES, css
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.tables import Results, column, headline, replace_file

_PAGE = (8.27, 11.69)
"""A4 [inch]."""

_LISTED = 12
"""Largest number of failed runs listed for each strategy."""

FIGURES = ("figure.pdf", "figure.png")
"""File names, one to print and one for the screen."""


def draw(
    folder: Path, results: Mapping[str, Results], summaries: Mapping[str, dict[str, Any]],
    about: str,
) -> None:
    """Draw settling times, their ratios to the best known ones, final errors and failures.

    Results and summaries are by strategy; `about` describes the conditions. The files `FIGURES`
    are written; `NotWrittenError` is raised if one cannot be.
    """
    # Not pyplot, which would look for a display and keep the figure in memory.
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=_PAGE, layout=ConstrainedLayoutEngine(w_pad=0.25, h_pad=0.15))
    axes = figure.subplots(3, 2, height_ratios=(3.0, 3.0, 2.0))
    figure.suptitle(f"Study\n{about}", fontsize=9, parse_math=False)
    slowest = max(max(column(found, "settle_time_s"), default=1.0) for found in results.values())
    bins = np.linspace(0.0, max(slowest, 1.0), 31)
    for axis in axes[:2].flat:
        axis.set_prop_cycle(color=[css(colour) for colour in SERIES])
    for name, found in results.items():
        runs = len(found)
        _share(axes[0, 0], column(found, "settle_time_s"), runs, name)
        axes[0, 1].hist(column(found, "settle_time_s"), bins=bins, alpha=0.5, label=name)
        _share(axes[1, 0], column(found, "ratio"), runs, name)
        # A logarithmic axis has no room beside the largest numbers.
        _share(axes[1, 1], np.minimum(column(found, "final_error"), LARGEST), runs, name)
    _label_axes(axes[0, 0], "settling time [s]", "share of all runs settled")
    _label_axes(axes[0, 1], "settling time [s]", "runs")
    _label_axes(axes[1, 0], "settling time / that of the best known motion", "share of all runs")
    _label_axes(axes[1, 1], "error at the end, ||x - x_d||", "share of all runs")
    axes[0, 1].yaxis.set_major_locator(MaxNLocator(integer=True))
    # One for all panels, beside them, where it covers no curve and no bar.
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right",
                  ncols=len(results), fontsize=8)
    if any(np.any(column(found, "final_error") > 0.0) for found in results.values()):
        axes[1, 1].set_xscale("log")
    axes[1, 1].axvline(SETTLED_ERROR, color="grey", linewidth=0.8)
    if not any(column(found, "ratio").size for found in results.values()):
        axes[1, 0].set_xticks([])
        _write_text(axes[1, 0], "best known motions are not part of this study", 0.5)
    axes[0, 0].set_xlim(left=0.0)
    for axis in axes[2]:
        axis.remove()
    text = figure.add_subplot(axes[2, 0].get_gridspec()[2, :])
    text.set_axis_off()
    _write_text(text, "\n".join(_text_lines(summaries)), 1.0)
    for file_name in FIGURES:
        path, page = folder / file_name, io.BytesIO()
        # Without a date the same study makes the same file.
        metadata = {"CreationDate": None} if path.suffix == ".pdf" else None
        figure.savefig(page, format=path.suffix[1:], dpi=110, metadata=metadata)
        replace_file(path, page.getvalue())


def describe(conditions: StudyConditions, runs: int) -> str:
    """Return a description of the conditions of a study in two lines."""
    simulator = conditions.simulator
    return (
        f"{runs} scenarios of {conditions.duration:g} s, plant {simulator.plant}, parameters "
        f"+-{conditions.perturbation:g} %, process noise {simulator.process_noise:g} a sample,\n"
        f"pose noise {simulator.position_noise:g} m and "
        f"{math.degrees(simulator.orientation_noise):.3g}°, "
        f"latency {conditions.latency:g} s"
    )


def _share(axis: Any, values: Vector, runs: int, label: str) -> None:
    ordered = np.sort(values)
    axis.step(ordered, np.arange(1, ordered.size + 1) / runs, where="post", label=label)
    axis.set_ylim(0.0, 1.02)


def _label_axes(axis: Any, horizontal: str, vertical: str) -> None:
    axis.set_xlabel(horizontal)
    axis.set_ylabel(vertical)
    axis.grid(alpha=0.3)


def _write_text(axis: Any, text: str, height: float) -> None:
    # As it is, and never as a formula: a strategy's error may have any text.
    axis.text(0.01, height, text, transform=axis.transAxes, fontsize=7.5, va="top",
              parse_math=False)


def _scientific(number: float | None) -> str:
    return "not finite" if number is None else f"{number:.2e}"


def _text_lines(summaries: Mapping[str, dict[str, Any]]) -> list[str]:
    lines = []
    for summary in summaries.values():
        lines.append(headline(summary))
        failures = summary["failures"]
        lines += [
            f"    run {f['run']}, seed {f['seed']}: "
            + (f["crash"] or f"error {_scientific(f['final_error'])} at the end")
            for f in failures[:_LISTED]
        ]
        if len(failures) > _LISTED:
            lines.append(f"    and {len(failures) - _LISTED} more failures, see summary.json")
        if not failures:
            lines.append("    no failures")
    return lines
