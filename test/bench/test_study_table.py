# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the tables of studies: settling times over best known ones, or beyond lower bounds."""

import json

import pytest
from study_table import row


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "runs.csv").write_text(
        "strategy,settle_time_s,final_error,lower_bound_s,bound_s,loose_settle_time_s,"
        "tail_error_p95\n"
        "paper,3.0,1e-3,3.0,2.0,2.5,0.02\npaper,4.0,2e-3,2.0,,3.5,0.04\n"
        "paper,,1.0,1.0,1.0,,\n"
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


@pytest.mark.parametrize("beyond", [False, True])
def test_time_below_a_larger_error_is_not_compared_with_settling(folder, beyond) -> None:
    expected = "| some | `paper` | 2 of 3 | 3.00 / 3.49 / 3.50 | - | 3.0e-02 / 4.0e-02 | 7 |"
    assert row("some", folder, True, beyond) == expected
