# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scripts of bench/ and bench/documents/: everything that they import exists."""

import runpy
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

BENCH = Path(__file__).parents[2] / "bench"


@pytest.mark.parametrize("script", sorted(BENCH.rglob("*.py")), ids=lambda path: path.stem)
def test_script_can_be_imported(script, monkeypatch) -> None:
    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])
    assert "__doc__" in runpy.run_path(str(script), run_name="imported")
