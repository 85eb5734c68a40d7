# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a study, of given results."""

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
