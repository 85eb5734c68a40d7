# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The report of a bag: its files, its page, and what it says of a bag it cannot read."""

import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from rosbags.typesys import Stores, get_typestore

from sphere_sim.cli.report import FIGURES, main
from sphere_sim.recording.bag_writer import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
POSE = "geometry_msgs/msg/PoseStamped"


def make_bag(folder: Path, poses: int = 100, goal: bool = True) -> Path:
    """Write a bag with poses and a goal and nothing else."""
    kinds = STORE.types
    writer = BagWriter(folder)
    for i in range(-1 if goal else 0, poses):
        stamp = 1_000_000_000 + max(i, 0) * 10_000_000
        time = kinds["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        x = 0.0 if i < 0 else np.exp(-i / 10.0)
        message = kinds[POSE](
            kinds["std_msgs/msg/Header"](time, "world"),
            kinds["geometry_msgs/msg/Pose"](
                kinds["geometry_msgs/msg/Point"](x, 0.0, 0.3),
                kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            ),
        )
        topic = "/controller/active_goal" if i < 0 else "/pose"
        writer.add_topic(topic, POSE)
        writer.write(topic, stamp, bytes(STORE.serialize_cdr(message, POSE)))
        if i % 200 == 0:
            writer.commit()
    writer.close()
    return folder


def test_report_of_one_bag_has_every_figure_and_the_tables(tmp_path, capsys) -> None:
    bag, out = make_bag(tmp_path / "run"), tmp_path / "out"
    assert main([str(bag), "--out", str(out), "--csv", "--parquet"]) == 0
    for name in FIGURES:
        assert (out / f"{name}.png").exists() and (out / f"{name}.svg").exists()
    table = np.genfromtxt(out / "motion.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["x"], np.exp(-np.arange(100) / 10.0), rtol=1e-12)
    assert pq.read_table(out / "motion.parquet").column_names == list(table.dtype.names)
    metrics = json.loads((out / "summary.json").read_text())["run"]["metrics"]
    assert metrics["settled"] and metrics["settle_time_s"] == pytest.approx(0.47, abs=1e-9)
    assert metrics["max_rotor_speed"] is None
    told = capsys.readouterr()
    assert "settling time" in told.out and "joint_states is missing" in told.err


def test_page_is_self_contained(tmp_path) -> None:
    out = tmp_path / "out"
    main([str(make_bag(tmp_path / "a&b")), "--out", str(out)])
    page = (out / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) == len(FIGURES)
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)
    assert "a&amp;b" in page and "http" not in re.sub(r'src="[^"]*"', "", page)


def test_several_bags_are_compared_under_different_names(tmp_path) -> None:
    bags = [make_bag(tmp_path / name / "bag") for name in ("one", "two")]
    out = tmp_path / "out"
    assert main([*map(str, bags), str(bags[0]), "--out", str(out)]) == 0
    assert (out / "comparison.png").exists() and (out / "two_panels.svg").exists()
    assert set(json.loads((out / "summary.json").read_text())) == {"one_1", "two", "one_2"}


def test_unreadable_bag_exits_with_1_and_one_line(tmp_path, capsys) -> None:
    assert main([str(tmp_path / "nothing"), "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "there is no such file or folder" in told


def test_run_without_a_goal_has_a_page_that_says_so(tmp_path, capsys) -> None:
    out = tmp_path / "out"
    bag = make_bag(tmp_path / "run", goal=False)
    assert main([str(bag), "--out", str(out), "--csv"]) == 0
    assert "nothing to measure" in (out / "report.html").read_text()
    told = capsys.readouterr()
    assert "goal_pose and active_goal are missing" in told.err
    assert "run: no figures, as no goal was in force at any pose; see the notes" in told.out
    notes = json.loads((out / "summary.json").read_text())["run"]["notes"]
    assert any("goal_pose and active_goal are missing" in note for note in notes)
    table = np.genfromtxt(out / "motion.csv", delimiter=",", names=True)
    assert np.all(np.isnan(table["error"])) and np.all(np.isfinite(table["x"]))


def test_empty_bag_is_told(tmp_path, capsys) -> None:
    bag = make_bag(tmp_path / "run", 0, goal=False)
    assert main([str(bag), "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "is empty" in told


def test_truncated_bag_is_reported_on_as_far_as_it_goes(tmp_path, capsys) -> None:
    bag = make_bag(tmp_path / "run", 1500)
    file = next(bag.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert main([str(bag), "--out", str(tmp_path / "out")]) == 0
    assert "breaks off" in capsys.readouterr().err
    notes = json.loads((tmp_path / "out" / "summary.json").read_text())["run"]["notes"]
    assert any("breaks off" in note for note in notes)


def test_bag_of_another_robot_is_told(tmp_path, capsys) -> None:
    assert main([str(make_bag(tmp_path / "run", 0)), "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "another robot's; has: /controller/active_goal" in told
