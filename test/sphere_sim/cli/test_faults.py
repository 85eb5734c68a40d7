# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The faults command prints complaints as they are."""

import io

import pytest

pytest.importorskip("rclpy")

from rich.console import Console

from sphere_sim.cli import faults
from sphere_sim.faults.outcome import Outcome, rows

COMPLAINT = "[sphere_nmpc]: /tmp/[/x]: given 1, expected 0 [s]"


def test_brackets_in_complaints_are_printed() -> None:
    outcome = Outcome("pose_nan", complaints=(COMPLAINT,))
    console = Console(file=io.StringIO(), width=200)
    console.print(faults._line(outcome), soft_wrap=True)
    faults._print(rows([outcome]), console)
    lines = console.file.getvalue().splitlines()
    assert lines.count(f"pose_nan: {COMPLAINT}") == 2
