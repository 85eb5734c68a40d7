# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a study, of given results: drawn whatever the runs and their errors are."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from sphere_sim.study import figure as module

pytestmark = pytest.mark.slow


def test_legend_covers_no_bar_and_runs_are_counted_in_whole_numbers(tmp_path, monkeypatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *rest, **named: drawn.append(self))
    monkeypatch.setattr(module, "_text_lines", lambda summaries: ["two strategies"])
    results = {
        name: [{"settle_time_s": time, "final_error": 1e-3 * time, "ratio": time}
               for time in (2.0, 5.0 + i)]
        for i, name in enumerate(("time_optimal", "paper"))
    }
    module.draw(tmp_path, results, {}, "runs of 5 s\non the rolling plant")
    figure = drawn[0]
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*results]
    low = legend.get_window_extent().y0
    assert all(axes.get_window_extent().y1 <= low for axes in figure.axes)
    assert not any(axes.get_legend() for axes in figure.axes)
    ticks = figure.axes[1].get_yticks()
    assert len(ticks) and np.all(ticks == np.round(ticks))


def row(**values: float) -> dict[str, Any]:
    return {"settle_time_s": None, "ratio": None, "final_error": None, **values}


@pytest.mark.filterwarnings("error")
def test_any_results_and_texts_are_drawn_without_a_warning(tmp_path: Path) -> None:
    results = {
        "crashed": [row()],
        "extreme": [row(final_error=1e300, ratio=1e30), row(final_error=1e-300), row()],
        "at once": [row(settle_time_s=0.0, final_error=0.0)],
    }
    none = {"count": 0}
    summary = {
        "strategy": "any", "settled": 0, "runs": 1, "crashed": 1, "settle_time_s": none,
        "ratio": none, "final_error": none,
        "failures": [{"run": 0, "seed": 1, "crash": r"no formula: $x_{ \frac$"}],
    }
    module.draw(tmp_path, results, dict.fromkeys(results, summary), "plant $x_{$")
    assert {file.name for file in tmp_path.iterdir()} == set(module.FIGURES)
