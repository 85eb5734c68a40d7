# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One run gives the same metrics from the bag of any recorder, by any clock.

The run is one of the nodes themselves. Its bag, by the package's own recorder, is the reference
for the bags that ``ros2 bag record`` makes of the same messages. Poses and joint states have the
same stamps in all of them, and so has the goal that the controller accepted, so nothing but
rounding may differ.
"""

import dataclasses
import json
import subprocess
from itertools import product
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from patience import PATIENCE
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from sphere_sim.cli.report import main
from sphere_sim.recording.run_reader import read_run
from sphere_sim.ros.session.child_process import verb_command

pytestmark = pytest.mark.slow
STORE = get_typestore(Stores.ROS2_JAZZY)
ROUNDING = 1e-9
POSE_PERIOD = 0.01
"""Of the simulator's poses [s]."""
TOPICS = (
    "/pose", "/joint_states", "/goal_pose", "/rotor_trajectory", "/controller/active_goal",
    "/controller/status",
)
DEMO = verb_command("demo", "--no-viewer")
KINDS = list(product(("sqlite3", "mcap"), ("", "file", "message")))


@pytest.fixture(scope="module")
def own(tmp_path_factory) -> Path:
    """Return the bag of a run in lockstep."""
    folder = tmp_path_factory.mktemp("own")
    subprocess.run(
        [*DEMO, "--rtf", "0", "--case", "3", "--strategy", "paper", "--no-compare",
         "--out", str(folder)],
        check=True, capture_output=True, timeout=PATIENCE,
    )
    return folder / "bag"


@pytest.fixture(scope="module")
def entries(own):
    """Return topic, type, log time and bytes of the messages as a user would record them."""
    with Reader(own) as reader:
        wanted = [it for it in reader.connections if it.topic in TOPICS]
        recorded = [(it.topic, it.msgtype, log, raw) for it, log, raw in reader.messages(wanted)]
    there = []
    for topic, msgtype, log, raw in recorded:
        if topic == "/controller/active_goal":
            # With an arbitrary stamp, as from a user; the real goal_pose may not be recorded.
            goal = STORE.deserialize_cdr(raw, msgtype)
            stamp = dataclasses.replace(goal.header.stamp, sec=12345)
            goal.header = dataclasses.replace(goal.header, stamp=stamp)
            typed = bytes(STORE.serialize_cdr(goal, msgtype))
            there.append(("/goal_pose", msgtype, log, typed))
        if topic != "/goal_pose":
            there.append((topic, msgtype, log, raw))
    assert {entry[0] for entry in there} == set(TOPICS)
    return there


def figures(run) -> dict[str, float]:
    metrics = run.metrics()
    assert metrics is not None, run.notes
    return dataclasses.asdict(metrics)


def same(given, expected) -> bool:
    return given == pytest.approx(expected, rel=ROUNDING, abs=ROUNDING)


@pytest.mark.parametrize("clock", ["system", "simulated"])
@pytest.mark.parametrize(("kind", "compression"), KINDS)
def test_metrics_are_those_of_the_own_recorder(
    own, entries, rosbag2, on_system_clock, kind, compression, clock
) -> None:
    expected = read_run(own)
    logged = on_system_clock(entries) if clock == "system" else entries
    bag = rosbag2(logged, kind, compression)
    for missing in (False, True):
        if missing:
            (bag / "metadata.yaml").unlink()
        run = read_run(bag)
        notes = ["metadata.yaml is missing, the storage was read without it"]
        assert list(run.notes) == notes * missing
        assert same(figures(run), figures(expected))
        assert same(run.times, expected.times) and same(run.goal_times, expected.goal_times)
        assert same(run.solves.times, expected.solves.times)
        assert same([it.start for it in run.plans], [it.start for it in expected.plans])


def test_report_has_the_same_metrics(
    own, entries, rosbag2, on_system_clock, tmp_path
) -> None:
    bags = [own, rosbag2(on_system_clock(entries), "sqlite3", "file", name="other")]
    assert main([*map(str, bags), "--out", str(tmp_path / "out")]) == 0
    reports = list(json.loads((tmp_path / "out" / "summary.json").read_text()).values())
    assert reports[0]["metrics"]["settled"] and len(reports[0]["metrics"]) == 9
    assert same(reports[1]["metrics"], reports[0]["metrics"])
    assert reports[1]["notes"] == []


@pytest.mark.parametrize("clock", ["system", "simulated"])
def test_goal_without_a_stamp_is_dated_within_a_pose_period(
    own, entries, rosbag2, on_system_clock, clock
) -> None:
    logged = [entry for entry in entries if entry[0] != "/controller/active_goal"]
    run = read_run(rosbag2(on_system_clock(logged) if clock == "system" else logged, "mcap"))
    found, expected = figures(run), figures(read_run(own))
    assert found["settle_time_s"] == pytest.approx(expected["settle_time_s"], abs=POSE_PERIOD)
    assert found["final_error"] == pytest.approx(expected["final_error"], rel=ROUNDING)


@pytest.mark.parametrize(
    ("missing", "unknown", "notes"),
    [
        ("/joint_states", {"max_rotor_speed", "max_rotor_torque_nm"},
         ("/joint_states is missing; no rotor speeds and torques",)),
        ("/controller/status", {"solve_ms_p50", "solve_ms_p99"},
         ("no status of the controller reports a solve; no solve times",)),
        ("/rotor_trajectory", set(), ("/rotor_trajectory is missing; no plans",)),
        ("/controller/active_goal", set(),
         ("active_goal is missing; goal_pose is used instead",)),
        ("/goal_pose", set(), ()),
    ],
)
def test_every_topic_but_the_poses_may_be_missing(
    own, entries, rosbag2, on_system_clock, missing, unknown, notes
) -> None:
    logged = on_system_clock([entry for entry in entries if entry[0] != missing])
    run = read_run(rosbag2(logged, "mcap", parts=1))
    expected, found = figures(read_run(own)), figures(run)
    assert {name for name, value in found.items() if np.isnan(value)} == unknown
    for name in found.keys() - unknown:
        assert same(found[name], expected[name])
    assert run.notes == notes


@pytest.mark.parametrize("number", [0, 1])
def test_single_file_of_a_split_bag_is_read_with_a_note(
    own, entries, rosbag2, on_system_clock, number
) -> None:
    bag = rosbag2(on_system_clock(entries), "sqlite3", "file")
    run = read_run(bag / f"mine_{number}.db3.zstd")
    assert f"mine_{1 - number}.db3.zstd beside it" in run.notes[0]
    assert 1 < len(run.times) < len(read_run(own).times)


@pytest.mark.parametrize(("kind", "compression"), KINDS)
def test_rosbags_reads_the_bags_of_this_test(
    entries, rosbag2, on_system_clock, kind, compression
) -> None:
    logged = on_system_clock(entries)
    bag = rosbag2(logged, kind, compression)
    with Reader(bag) as reader:
        assert [log for _, log, _ in reader.messages()] == [entry[2] for entry in logged]
