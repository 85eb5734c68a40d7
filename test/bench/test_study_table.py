# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the tables of studies: settling times over best known times, or beyond lower bounds."""

import json

import pytest
from study_table import row


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "runs.csv").write_text(
        "strategy,settle_time_s,final_error,lower_bound_s,bound_s\n"
        "paper,3.0,1e-3,3.0,2.0\npaper,4.0,2e-3,2.0,\npaper,,1.0,1.0,1.0\n"
    )
    summary = {"timing": {"solve_ms_max": 7.0}}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    return tmp_path


@pytest.mark.parametrize(
    ("beyond", "compared"), [(False, "1.50 / 1.50 / 1.50"), (True, "1.00 / 1.98 / 2.00")]
)
def test_row_compares_with_the_bound_that_is_asked_for(folder, beyond, compared) -> None:
    start = "| some | `paper` | 2 of 3 | 3.50 / 3.99 / 4.00 | "
    assert row("some", folder, False, beyond) == f"{start}{compared} | 2.0e-03 / 1.0e+00 | 7 |"
