# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
from sphere_nmpc.fault_log import FaultLog


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


def test_what_was_held_back_is_caught_up_with_once_its_time_has_come() -> None:
    lines: list[str] = []
    now = [0.0]
    goals = FaultLog(lines.append, period=2.0, clock=lambda: now[0])
    for number in range(100):
        now[0] = 0.01 * number
        goals.report("goal", str(number))
        goals.catch_up()
    assert lines == ["goal: 0"]
    now[0] = 2.0
    goals.catch_up()
    goals.catch_up()
    assert lines == ["goal: 0", "goal: 99 (98 more since last told)"]
    now[0] = 10.0
    goals.report("goal", "100")
    goals.catch_up()
    assert lines[2:] == ["goal: 100"]
