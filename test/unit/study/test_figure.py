# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of a study: drawn whatever the runs and their errors are."""

from pathlib import Path
from typing import Any

import pytest

from sphere_sim.study.figure import FIGURES, draw

pytestmark = pytest.mark.slow


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
    draw(tmp_path, results, dict.fromkeys(results, summary), "plant $x_{$")
    assert {file.name for file in tmp_path.iterdir()} == set(FIGURES)
