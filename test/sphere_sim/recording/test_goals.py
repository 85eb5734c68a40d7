# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals, plans and solves get the right times from stamps and log times."""

import numpy as np
import pytest
from recorded_bags import (
    START,
    changed,
    goal_at,
    in_order,
    on_the_system_clock,
    run_messages,
    without,
    write_own,
    write_rosbag2,
)

from sphere_sim.cli.report import main
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report import report_files

POSE_PERIOD = 0.01


def run_with(tmp_path, *entries):
    """Return the run as ``ros2 bag record`` logs it, without simulated time."""
    return read_run(write_rosbag2(tmp_path / "bag", on_the_system_clock(in_order(*entries))))


@pytest.mark.parametrize(
    ("topic", "stamp", "time", "tolerance"),
    [
        # When the controller accepted it.
        ("/controller/active_goal", START + 1_480_000_000, 1.48, 1e-9),
        ("/controller/active_goal", 0, 1.5, POSE_PERIOD),  # from a controller without a clock
        # Latched since before the recording.
        ("/controller/active_goal", START - 4_000_000_000, -4.0, 1e-9),
        # Of another clock.
        ("/controller/active_goal", START + 90_000_000_000, 1.5, POSE_PERIOD),
        ("/controller/active_goal", 1_800_000_000_000_000_000, 1.5, POSE_PERIOD),
        # Whatever a user has set.
        ("/goal_pose", 0, 1.5, POSE_PERIOD),
        ("/goal_pose", START + 1_000_000_000, 1.5, POSE_PERIOD),
    ],
)
def test_plausible_stamp_of_the_controller_is_used(
    tmp_path, topic, stamp, time, tolerance
) -> None:
    rest = without(run_messages(), "goal_pose", "active_goal")
    goal = (topic, *changed(goal_at(0.0, 1.5), stamp=stamp)[1:])
    run = run_with(tmp_path, goal, *rest)
    assert run.goal_times == pytest.approx([time], abs=tolerance)
    assert np.all(np.isfinite(run.goals_in_force[run.times >= max(time, 0.0) + POSE_PERIOD]))
    assert run.metrics() is not None


def test_plans_and_solves_without_simulated_time_are_dated_by_their_log_times(tmp_path) -> None:
    def shift(message) -> None:
        for pair in message.values:
            if pair.key == "time_s":
                pair.value = str(float(pair.value) + 70.0)

    entries = [
        changed(entry, stamp=0) if entry[0] == "/rotor_trajectory" else
        changed(entry, edit=shift) if entry[0] == "/controller/status" else entry
        for entry in run_messages()
    ]
    run = run_with(tmp_path, *entries)
    starts = [plan.start for plan in run.plans]
    assert starts == pytest.approx(0.5 * np.arange(7), abs=POSE_PERIOD)
    assert run.solves.times == pytest.approx(0.5 * np.arange(7), abs=POSE_PERIOD)


@pytest.mark.parametrize(
    ("goals", "kept", "notes"),
    [
        # After the last pose.
        ([(0.0, 0.0), (7.0, 3.5)], [0.0], ["goal at 3.5 s, poses from 0 to 3 s: ignored"]),
        # Replaced before the next pose.
        ([(0.0, 0.0), *((float(i), 1.001 + 1e-3 * i) for i in range(1, 5))], [0.0, 4.0],
         ["3 goals were replaced before the next pose: ignored"]),
        # Sent again.
        ([(0.0, 0.5), (0.0, 1.5), (0.0, 2.5)], [0.0], []),
    ],
)
def test_goals_that_were_not_in_force_are_ignored(tmp_path, goals, kept, notes) -> None:
    given = [goal_at(x, time) for x, time in goals]
    entries = in_order(*given, *without(run_messages(), "active_goal"))
    run = read_run(write_own(tmp_path / "bag", entries))
    np.testing.assert_allclose(run.goals[:, 0], kept)
    assert run.goal_times[0] == pytest.approx(goals[0][1], abs=1e-9)
    assert list(run.notes) == [f"/controller/active_goal: {note}" for note in notes]


def test_report_says_why_a_run_has_no_goal(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(report_files, "FIGURES", {})
    entries = without(run_messages(), "goal_pose", "active_goal")
    bag, out = write_own(tmp_path / "mine", [*entries, goal_at(0.0, 7.25)]), tmp_path / "out"
    assert main([str(bag), "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert "mine: no metrics, as no goal was in force at any pose" in printed.out
    reason = "goal at 7.25 s, poses from 0 to 3 s: no goal falls inside the recording"
    assert reason in printed.err
    assert reason in (out / "summary.json").read_text()
    assert reason in (out / "report.html").read_text()
