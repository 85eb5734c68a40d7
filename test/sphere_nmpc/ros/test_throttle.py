# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
from sphere_nmpc.ros.throttle import FaultLog


def test_fault_is_told_at_once_then_with_a_count() -> None:
    lines: list[str] = []
    now = [0.0]
    faults = FaultLog(lines.append, period=5.0, clock=lambda: now[0])
    for now[0] in (0.0, 0.1, 4.9):
        faults.report("pose refused", "given nan")
    assert lines == ["pose refused: given nan"]
    faults.report("goal refused", "given map")
    assert lines[1:] == ["goal refused: given map"]
    now[0] = 5.0
    faults.report("pose refused", "given inf")
    assert lines[2:] == ["pose refused: given inf (2 more since last told)"]
    assert faults.counts == {"pose refused": 4, "goal refused": 1}
