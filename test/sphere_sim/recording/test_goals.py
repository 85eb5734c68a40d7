# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals, plans and solves get the right times from stamps and log times."""

import dataclasses

import numpy as np
import pytest

from sphere_sim.cli.report import main
from sphere_sim.recording.run_reader import read_run

POSE_PERIOD = 0.01
START = 5_000_000_000
"""Stamp of the first pose of `messages` [ns]; that of the last is 3 s later."""


def stamped(entry, stamp: int):
    """Return an entry with another stamp [ns] in its message and the same log time."""
    message = entry[3]
    time = dataclasses.replace(
        message.header.stamp, sec=stamp // 10**9, nanosec=stamp % 10**9
    )
    header = dataclasses.replace(message.header, stamp=time)
    return (*entry[:3], dataclasses.replace(message, header=header))


def later(entries, topic: str, time: float, stamp: int):
    """Return entries with the goals of `topic` at `time` [s] since the first pose, and `stamp`."""
    goals = [stamped(entry, stamp) for entry in entries if entry[0] == topic]
    rest = [entry for entry in entries if not entry[0].endswith(("goal_pose", "active_goal"))]
    log = START + round(time * 1e9)
    place = next((i for i, entry in enumerate(rest) if entry[2] > log), len(rest))
    return [*rest[:place], *((*goal[:2], log, goal[3]) for goal in goals), *rest[place:]]


def run_of(rosbag2, on_system_clock, entries):
    """Return the run as ``ros2 bag record`` logs it, without simulated time."""
    return read_run(rosbag2(on_system_clock(entries, goals_first=False), "mcap", parts=1))


@pytest.mark.parametrize("stamp", [0, 12_345_000_000_000, 1_700_000_000_000_000_000])
def test_stamp_of_goal_pose_is_not_used(
    rosbag2, on_system_clock, messages, stamp
) -> None:
    entries = later(list(messages()), "/goal_pose", 1.5, stamp)
    run = run_of(rosbag2, on_system_clock, entries)
    assert run.goal_times == pytest.approx([1.5], abs=POSE_PERIOD)
    assert run.metrics() is not None


@pytest.mark.parametrize(
    ("stamp", "time", "tolerance"),
    [
        (START + 1_480_000_000, 1.48, 1e-9),  # when the controller accepted it
        (0, 1.5, POSE_PERIOD),  # from a controller without a clock
        (START - 4_000_000_000, -4.0, 1e-9),  # latched since before the recording
        (START + 90_000_000_000, 1.5, POSE_PERIOD),  # of another clock
        (1_800_000_000_000_000_000, 1.5, POSE_PERIOD),
    ],
)
def test_plausible_stamp_of_active_goal_is_used(
    rosbag2, on_system_clock, messages, stamp, time, tolerance
) -> None:
    entries = later(list(messages()), "/controller/active_goal", 1.5, stamp)
    run = run_of(rosbag2, on_system_clock, entries)
    assert run.goal_times == pytest.approx([time], abs=tolerance)
    assert np.all(np.isfinite(run.goals_in_force[run.times >= max(time, 0.0) + POSE_PERIOD]))


def test_latched_goal_is_in_force_from_the_start(rosbag2, on_system_clock, messages) -> None:
    kept = later(list(messages()), "/controller/active_goal", 0.7, START - 4_000_000_000)
    run, whole = run_of(rosbag2, on_system_clock, kept), read_run(rosbag2(
        messages(), "sqlite3", name="whole"
    ))
    assert run.metrics() == whole.metrics()


def test_plans_without_a_stamp_start_at_their_log_time(rosbag2, on_system_clock, messages) -> None:
    entries = [
        stamped(entry, 0) if entry[0] == "/rotor_trajectory" else entry for entry in messages()
    ]
    run = run_of(rosbag2, on_system_clock, entries)
    starts = [plan.start for plan in run.plans]
    assert starts == pytest.approx(0.5 * np.arange(7), abs=POSE_PERIOD)


def test_solve_times_of_a_controller_without_simulated_time(
    rosbag2, on_system_clock, messages
) -> None:
    entries = []
    for entry in messages():
        if entry[0] == "/controller/status":
            pairs = [
                dataclasses.replace(it, value=str(float(it.value) + 70.0))
                if it.key == "time_s" else it for it in entry[3].values
            ]
            entry = (*entry[:3], dataclasses.replace(entry[3], values=pairs))
        entries.append(entry)
    run = run_of(rosbag2, on_system_clock, entries)
    assert run.solves.times == pytest.approx(0.5 * np.arange(7), abs=POSE_PERIOD)
    with_sim_time = run_of(
        lambda *how, **more: rosbag2(*how, name="sim_time", **more), on_system_clock,
        list(messages()),
    )
    np.testing.assert_allclose(with_sim_time.solves.times, 0.5 * np.arange(7), atol=1e-9)


def test_goal_after_the_last_pose_is_ignored(
    rosbag2, messages
) -> None:
    entries = list(messages())
    goal = next(entry for entry in entries if entry[0] == "/controller/active_goal")
    pose = goal[3].pose
    elsewhere = dataclasses.replace(pose, position=dataclasses.replace(pose.position, x=7.0))
    other = dataclasses.replace(goal[3], pose=elsewhere)
    late = (*goal[:2], START + 3_500_000_000, other)
    run = read_run(rosbag2([*entries, late], "mcap"))
    assert len(run.goals) == 1 and run.metrics() is not None
    assert run.notes == (
        "/controller/active_goal: goal at 3.5 s, poses from 0 to 3 s: ignored",
    )


def test_goals_that_no_pose_follows_are_ignored(rosbag2, messages) -> None:
    entries = list(messages())
    goal = next(entry for entry in entries if entry[0] == "/controller/active_goal")
    first = next(i for i, entry in enumerate(entries) if entry[2] > START + 1_000_000_000)
    quick = []
    for i in range(1, 5):
        x = dataclasses.replace(goal[3].pose.position, x=float(i))
        pose = dataclasses.replace(goal[3].pose, position=x)
        entry = (*goal[:3], dataclasses.replace(goal[3], pose=pose))
        time = START + 1_001_000_000 + i * 1_000_000
        quick.append((*stamped(entry, time)[:2], time, stamped(entry, time)[3]))
    run = read_run(rosbag2([*entries[:first], *quick, *entries[first:]], "mcap"))
    np.testing.assert_allclose(run.goals[:, 0], [0.0, 4.0])
    assert run.notes == (
        "/controller/active_goal: 3 goals were replaced before the next pose: ignored",
    )


def test_run_to_each_goal_has_what_belongs_to_it(rosbag2, messages) -> None:
    entries = list(messages())
    goal = next(entry for entry in entries if entry[0] == "/controller/active_goal")
    x = dataclasses.replace(goal[3].pose.position, x=5.0)
    other = dataclasses.replace(goal[3], pose=dataclasses.replace(goal[3].pose, position=x))
    entries = later(entries, "/controller/active_goal", 1.0, START + 1_000_000_000)
    whole = read_run(rosbag2([stamped((*goal[:3], other), START), *entries], "mcap"))
    first, last = whole.to_goal(1), whole.to_goal(2)
    np.testing.assert_allclose(first.times, 0.01 * np.arange(100), atol=1e-9)
    np.testing.assert_allclose(last.times, 0.01 * np.arange(201), atol=1e-9)
    np.testing.assert_allclose(first.solves.times, [0.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(last.solves.times, 0.5 * np.arange(5), atol=1e-9)
    assert [plan.start for plan in last.plans] == pytest.approx(0.5 * np.arange(5))
    assert len(first.joint_times) == 100 and len(first.goals) == len(last.goals) == 1
    assert last.origin == pytest.approx(whole.origin + 1.0)
    assert (first.name, last.name) == ("mine, goal 1", "mine, goal 2")
    # The run to a goal is a run: its own run to its goal is the same.
    assert whole.metrics() == last.metrics() == last.to_goal(1).metrics()
    assert first.metrics() != last.metrics()
    assert first.goal[0] == 5.0 and last.goal[0] == 0.0


def test_report_says_why_a_run_has_no_goal(rosbag2, messages, tmp_path, capsys) -> None:
    entries = later(list(messages()), "/controller/active_goal", 7.25, 0)
    bag, out = rosbag2(entries, "mcap", parts=1), tmp_path / "out"
    assert main([str(bag), "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert "mine: no metrics, as no goal was in force at any pose" in printed.out
    reason = "goal at 7.25 s, poses from 0 to 3 s: no goal falls inside the recording"
    assert reason in printed.err
    assert reason in (out / "summary.json").read_text()
    assert reason in (out / "report.html").read_text()


def test_invalid_goals_and_plans_are_ignored_with_a_note(rosbag2, messages) -> None:
    entries = list(messages())
    for i, entry in enumerate(entries):
        if entry[0] == "/controller/active_goal":
            pose = entry[3].pose
            turn = dataclasses.replace(pose.orientation, w=0.3)
            wrong = dataclasses.replace(entry[3], pose=dataclasses.replace(pose, orientation=turn))
            entries.insert(i, (*entry[:3], wrong))
            break
    plan = next(entry for entry in entries if entry[0] == "/rotor_trajectory")
    foreign = dataclasses.replace(plan[3], joint_names=["hip", "knee"])
    run = read_run(rosbag2([*entries, (*plan[:3], foreign)], "mcap"))
    assert len(run.goals) == 1 and len(run.plans) == 7
    assert run.notes == (
        "/controller/active_goal: 1 invalid goals were ignored",
        "/rotor_trajectory: 1 invalid trajectories were ignored",
    )


def test_longest_run_is_used_after_a_restart_of_the_simulator(
    rosbag2, on_system_clock, messages
) -> None:
    whole = list(messages())
    short = [entry for entry in whole if entry[2] < START + 2_000_000_000]
    logged = on_system_clock([*short, *whole, *short], goals_first=False)
    run, expected = read_run(rosbag2(logged, "mcap")), read_run(rosbag2(
        on_system_clock(whole, goals_first=False), "mcap", name="whole"
    ))
    assert run.metrics() == expected.metrics()
    for name in ("times", "joint_times", "rotor_speeds", "goals_in_force"):
        np.testing.assert_array_equal(getattr(run, name), getattr(expected, name))
    assert len(run.plans) == len(expected.plans) == 7 and len(run.solves.times) == 7
    assert run.notes[0].startswith("/pose: time goes back, so the bag holds several runs")


def test_repeated_goal_is_in_force_from_the_first_time(
    rosbag2, on_system_clock, messages
) -> None:
    entries = later(list(messages()), "/controller/active_goal", 0.5, START + 500_000_000)
    goals = [entry for entry in entries if entry[0].endswith("active_goal")]
    assert goals
    entries = list(entries)
    for entry in goals:
        for more in (1_000_000_000, 2_000_000_000):
            again = stamped(entry, START + 500_000_000 + more)
            log = entry[2] + more
            place = next((i for i, one in enumerate(entries) if one[2] > log), len(entries))
            entries.insert(place, (*again[:2], log, again[3]))
    run = run_of(rosbag2, on_system_clock, entries)
    assert run.goal_times == pytest.approx([0.5])
