# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The walk through the code is no longer than the committed one."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

pytest.importorskip("rclpy")

WALK = Path(__file__).parents[2] / "bench/walk.py"


def test_no_instant_makes_more_calls_than_committed() -> None:
    command = [sys.executable, str(WALK), "--counts"]
    found = subprocess.run(command, capture_output=True, text=True)
    assert found.returncode == 0, f"{found.stdout}{found.stderr}"
