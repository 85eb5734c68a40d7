# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A study on one page."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.study.summary import Results, column, headline
from sphere_sim.study.tables import replace_file

_PAGE = (8.27, 11.69)
"""A4 [inch]."""

_LISTED = 12
"""Failures listed for each strategy."""

FIGURES = ("figure.pdf", "figure.png")


def draw(
    folder: Path,
    results: Mapping[str, Results],
    summaries: Mapping[str, dict[str, Any]],
    about: str,
) -> None:
    """Draw settling times, ratios to the bound, error floor and failures.

    Parameters
    ----------
    folder : Path
        Where the figure is written, to be printed and to be looked at.
    results : mapping of str to sequence of dict
        For each strategy what each run came to.
    summaries : mapping of str to dict
        Their summaries.
    about : str
        Under which conditions they were made.
    """
    # No pyplot: it would look for a display and keep the figure.
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=_PAGE, layout=ConstrainedLayoutEngine(w_pad=0.25, h_pad=0.15))
    axes = figure.subplots(3, 2, height_ratios=(3.0, 3.0, 2.0))
    figure.suptitle(f"Study\n{about}", fontsize=9)
    slowest = max(max(column(found, "settle_time_s"), default=1.0) for found in results.values())
    bins = np.linspace(0.0, max(slowest, 1.0), 31)
    for name, found in results.items():
        runs = len(found)
        _share(axes[0, 0], column(found, "settle_time_s"), runs, name)
        axes[0, 1].hist(column(found, "settle_time_s"), bins=bins, alpha=0.5, label=name)
        _share(axes[1, 0], column(found, "ratio"), runs, name)
        _share(axes[1, 1], column(found, "final_error"), runs, name)
    _name(axes[0, 0], "settling time [s]", "share of all runs settled")
    _name(axes[0, 1], "settling time [s]", "runs")
    _name(axes[1, 0], "settling time / best known time", "share of all runs")
    _name(axes[1, 1], "error at the end, ||x - x_d||", "share of all runs")
    if any(np.any(column(found, "final_error") > 0.0) for found in results.values()):
        axes[1, 1].set_xscale("log")
    axes[1, 1].axvline(SETTLED_ERROR, color="grey", linewidth=0.8)
    if not any(column(found, "ratio").size for found in results.values()):
        axes[1, 0].set_xticks([])
        _write(axes[1, 0], "best known times are not part of this study", 0.5)
    axes[0, 0].set_xlim(left=0.0)
    for axis in axes[2]:
        axis.remove()
    text = figure.add_subplot(axes[2, 0].get_gridspec()[2, :])
    text.set_axis_off()
    _write(text, "\n".join(_words(summaries)), 1.0)
    for file_name in FIGURES:
        path, page = folder / file_name, io.BytesIO()
        # Without its date the same study makes the same file.
        metadata = {"CreationDate": None} if path.suffix == ".pdf" else None
        figure.savefig(page, format=path.suffix[1:], dpi=110, metadata=metadata)
        replace_file(path, page.getvalue())


def _share(axis: Any, values: Vector, runs: int, label: str) -> None:
    ordered = np.sort(values)
    axis.step(ordered, np.arange(1, ordered.size + 1) / runs, where="post", label=label)
    axis.set_ylim(0.0, 1.02)


def _name(axis: Any, horizontal: str, vertical: str) -> None:
    axis.set_xlabel(horizontal)
    axis.set_ylabel(vertical)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)


def _write(axis: Any, words: str, height: float) -> None:
    axis.text(0.01, height, words, transform=axis.transAxes, fontsize=7.5, va="top")


def _scientific(number: float | None) -> str:
    return "not finite" if number is None else f"{number:.2e}"


def _words(summaries: Mapping[str, dict[str, Any]]) -> list[str]:
    words = []
    for summary in summaries.values():
        words.append(headline(summary))
        failures = summary["failures"]
        words += [
            f"    run {f['run']}, seed {f['seed']}: "
            + (f["crash"] or f"error {_scientific(f['final_error'])} at the end")
            for f in failures[:_LISTED]
        ]
        if len(failures) > _LISTED:
            words.append(f"    and {len(failures) - _LISTED} more failures, see summary.json")
        if not failures:
            words.append("    no failures")
    return words
