# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Display of the way to goals."""

import math

import pytest

pytest.importorskip("rich")

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from sphere_sim.recording.message_fields import ReportedProgress, reported_progress
from sphere_sim.ros.session.controller_status import ControllerStatus
from sphere_sim.ros.session.goal_display import GoalDisplay, Way


def test_share_grows_over_all_goals_and_falls_with_a_longer_way() -> None:
    way, shares = Way(), []
    for index, left in ((0, math.nan), (0, 4.0), (0, 1.0), (1, math.nan), (1, 2.0), (1, 3.0),
                        (1, 0.0)):
        way.add(ReportedProgress("1.0", index, 2, 1.0, left))
        shares.append(way.share)
    assert shares == [0.0, 0.0, 0.375, 0.5, 0.5, 0.5, 1.0]


@pytest.mark.parametrize(
    ("values", "index", "count"),
    [
        ({"goal_index": "1", "goal_count": "3"}, 1, 3),
        ({}, 0, 0),
        ({"goal_index": "3", "goal_count": "3"}, 0, 0),
        ({"goal_index": "x", "goal_count": "1"}, 0, 0),
        ({"goal_index": "0", "goal_count": "1e300"}, 0, 0),
    ],
)
def test_goals_of_a_status_are_numbered_or_unknown(values, index, count) -> None:
    progress = reported_progress(values)
    assert (progress.index, progress.count) == (index, count)
    assert math.isnan(progress.time_left) and math.isnan(progress.distance_left)


@pytest.mark.parametrize("terminal", [True, False])
def test_display_is_a_bar_on_a_terminal_and_else_a_line(
    graph, terminal, monkeypatch, capsys
) -> None:
    if terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("TERM", "xterm-256color")
    status = ControllerStatus(graph.probe)
    publisher = graph.publisher(DiagnosticStatus, "controller/status")
    given = {"mode": "on the way to the goal [bold]", "goal_index": "1", "goal_count": "3",
             "time_left_s": "4.25", "distance_left_m": "nan", "goal_stamp": "1.0"}
    with GoalDisplay(status) as display:
        display.update()  # nothing is known: nothing is shown
        publisher.publish(
            DiagnosticStatus(values=[KeyValue(key=k, value=v) for k, v in given.items()])
        )
        graph.until(lambda: status.count > 0)
        display.update()
        display.update()  # not due yet
    printed = capsys.readouterr()
    text = "goal 2 of 3:      – m,   4.2 s left"
    assert printed.out == ""
    if terminal:
        assert text in printed.err and "\x1b[" in printed.err and "\u2501" in printed.err
    else:
        assert printed.err == f"{text}, on the way to the goal [bold]\n"
