# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Display of the way to goals."""

import math

import pytest

pytest.importorskip("rich")

from sphere_nmpc.control.goal_report import GoalReport
from sphere_sim.ros.session.goal_display import GoalDisplay, Way


def test_share_grows_over_all_goals_and_falls_with_a_longer_way() -> None:
    way, shares = Way(), []
    for index, left in ((0, math.nan), (0, 4.0), (0, 1.0), (1, math.nan), (1, 2.0), (1, 3.0),
                        (1, 0.0)):
        way.add(GoalReport("1.0", index, 2, distance_left=left))
        shares.append(way.share)
    assert shares == [0.0, 0.0, 0.375, 0.5, 0.5, 0.5, 1.0]


@pytest.mark.parametrize("terminal", [True, False])
def test_display_is_a_bar_on_a_terminal_and_else_a_line(terminal, monkeypatch, capsys) -> None:
    if terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("TERM", "xterm-256color")
    report = GoalReport("1.0", 1, 3, "on the way to the goal [bold]", time_left=4.25)
    with GoalDisplay() as display:
        display.update(GoalReport())  # nothing is known: nothing is shown
        display.update(report)
        display.update(report)  # not due yet
    printed = capsys.readouterr()
    text = "goal 2 of 3:      – m,   4.2 s left"
    assert printed.out == ""
    if terminal:
        assert text in printed.err and "\x1b[" in printed.err and "\u2501" in printed.err
    else:
        assert printed.err == f"{text}, on the way to the goal [bold]\n"
