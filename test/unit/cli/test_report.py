# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Reports of bags: files, page, and errors for bags that cannot be read."""

import json
import os
import re
import resource
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from patience import PATIENCE
from recorded_bags import (
    POSE,
    STATUS,
    Entry,
    changed,
    demand,
    diagnostics,
    goal_at,
    in_order,
    make,
    momentum_messages,
    pose,
    status,
    walled_messages,
    without,
    write_own,
)

from sphere_sim.cli.main import main as command
from sphere_sim.cli.report import main
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report import report_files
from sphere_sim.ros.session.process_set import verb_command

pytestmark = pytest.mark.slow


def approach(goals: int = 1) -> Iterator[Entry]:
    """Yield poses and goals and nothing else.

    Goal k, from 0 on, comes into force after k seconds and is at x = k; the poses approach it from
    k + 1 metres away.
    """
    for i in range(100 * max(1, goals)):
        stamp, k = 5_000_000_000 + i * 10_000_000, min(i // 100, max(0, goals - 1))
        if goals and i % 100 == 0:
            yield goal_at(float(k), float(k))
        x = k + (k + 1) * np.exp(-(i - 100 * k) / 10.0)
        yield "/pose", POSE, stamp, pose(stamp, (x, 0.0, 1.0, 0.0, 0.0, 0.0))


OVER = make("geometry_msgs/msg/Quaternion", x=1.0, y=0.0, z=0.0, w=0.0)


def make_bag(folder: Path, goals: int = 1) -> Path:
    return write_own(folder, approach(goals))


FIGURES = report_files.FIGURES


@pytest.fixture
def one_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw one figure of each run: drawing takes long."""
    monkeypatch.setattr(report_files, "FIGURES", {"value": FIGURES["value"]})


def report(*arguments: str, limit: int | None = None, **environment: str):
    """Run the command in a process, with a limit on the size of its files [bytes]."""
    def restrict() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        verb_command("report", *arguments),
        capture_output=True, text=True, timeout=PATIENCE, preexec_fn=restrict,
        # Bytecode that the limit truncates would break each later import.
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **environment},
    )


def test_report_of_one_bag_is_complete_also_outside_of_the_locale(tmp_path) -> None:
    bag, out = make_bag(tmp_path / "a&büg" / "bag"), tmp_path / "örep"
    ended = report(
        str(bag), "--out", str(out), "--csv", "--parquet", LC_ALL="C", PYTHONUTF8="0",
        PYTHONCOERCECLOCALE="0", PYTHONIOENCODING="ascii",
    )
    assert ended.returncode == 0, ended.stderr
    assert "settling time" in ended.stdout and "joint_states is missing" in ended.stderr
    for name in FIGURES:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (out / f"{name}.svg").read_text()
    table = np.genfromtxt(out / "motion.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["x"], np.exp(-np.arange(100) / 10.0), rtol=1e-12)
    assert pq.read_table(out / "motion.parquet").column_names == list(table.dtype.names)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    metrics = summary["a&büg"]["metrics"]
    assert metrics["settled"] and metrics["settle_time_s"] == pytest.approx(0.47, abs=1e-9)
    assert metrics["max_rotor_speed"] is None
    page = (out / "report.html").read_text(encoding="utf-8")
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) == len(FIGURES)
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)
    assert "a&amp;büg" in page and "http" not in re.sub(r'src="[^"]*"', "", page)


def test_momentum_and_pushes_are_reported(tmp_path, capsys, one_figure) -> None:
    bag, out = write_own(tmp_path / "run", momentum_messages()), tmp_path / "out"
    assert main([str(bag), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text())["run"]
    assert (out / "momentum.svg").exists()
    assert "run: push 1 0.559 N s at 1 s" in printed
    assert "momentum at the end, estimated 0.168 N m s" in printed
    (push,) = summary["momentum"]["pushes"]
    assert summary["momentum"]["end_nms"] == pytest.approx([0.075, 0.15, 0.0])
    assert push["impulse_ns"] == [0.5, -0.25] and push["time_s"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("least", "contacts", "told"),
    [(0.1, 0, "touches of what is occupied 0\n"),
     # The front of the sphere is at the wall, 1 m, after 3.5 s.
     (-0.1, 1, "touches of what is occupied 1, the first at 3.5 s\n")],
)
def test_clearance_is_reported_and_touches_are_told_first(
    tmp_path, capsys, one_figure, least, contacts, told
) -> None:
    bag, out = write_own(tmp_path / "run", walled_messages(least)), tmp_path / "out"
    assert main([str(bag), "--out", str(out), "--csv"]) == 0
    printed = capsys.readouterr().out
    assert f"run: least clearance {1e3 * least:g} mm" in printed and told in printed
    floor = json.loads((out / "summary.json").read_text())["run"]["floor"]
    assert floor["least_clearance_m"] == pytest.approx(least, abs=1e-6)
    assert floor["contacts"] == contacts
    assert floor["first_contact_s"] == (pytest.approx(3.5, abs=0.021) if contacts else None)
    table = np.genfromtxt(out / "motion.csv", delimiter=",", names=True)
    assert np.min(table["clearance_m"]) == pytest.approx(least, abs=1e-6)
    assert (out / "clearance.svg").exists()
    alarm = "run: the sphere touched what is occupied on the floor: 1, the first at 3.5 s"
    assert (alarm in (out / "report.html").read_text()) is bool(contacts)


def test_contacts_that_the_simulator_counts_are_touches_although_walls_stop_the_sphere_before(
    tmp_path, capsys, one_figure
) -> None:
    counts = [
        diagnostics(10**9 * i, name, wall_touched=count) for i, name, count in (
            (2, "simulator: commands", 1), (3, "second/simulator: commands", 9),
            (4, "simulator: commands", 3), (4, "simulator: clock", 7),
        )
    ]
    bag = write_own(tmp_path / "run", in_order(*walled_messages(0.1), *counts))
    assert main([str(bag), "--out", str(tmp_path / "out")]) == 0
    assert "run: touches of what is occupied 3, the first at 1 s\n" in capsys.readouterr().out
    floor = json.loads((tmp_path / "out" / "summary.json").read_text())["run"]["floor"]
    assert floor["contacts"] == 3 and floor["least_clearance_m"] == pytest.approx(0.1, abs=1e-6)


def test_report_without_a_floor_has_nothing_of_one(tmp_path, capsys, one_figure) -> None:
    bag = write_own(tmp_path / "run", without(walled_messages(0.1), "/floor", "/status"))
    assert main([str(bag), "--out", str(tmp_path / "out"), "--csv"]) == 0
    texts = [capsys.readouterr().out] + [
        file.read_text() for file in (tmp_path / "out").iterdir() if file.suffix != ".png"
    ]
    assert not any(word in text for word in ("clearance", "occupied") for text in texts)


SETTLED_AFTER = (0.47, 0.53, 0.58)
"""Settling times of the goals of `make_bag` [s]."""


def test_bag_of_several_goals_has_a_row_for_each_and_says_whose_figures_are_drawn(
    tmp_path, capsys, one_figure
) -> None:
    bag, out = make_bag(tmp_path / "run", goals=3), tmp_path / "out"
    assert main([str(bag), "--out", str(out), "--csv", "--parquet"]) == 0
    told = "3 goals; figures of goal 3; --goal 1 2 ... or --goal all for others"
    printed = capsys.readouterr().out
    assert f"run: {told}\n" in printed
    assert "run, goal 3: settling time (error < 1e-2) 0.58 s" in printed
    table = np.genfromtxt(out / "goals.csv", delimiter=",", names=True)
    assert pq.read_table(out / "goals.parquet").column_names == list(table.dtype.names)
    np.testing.assert_allclose(table["goal"], [1, 2, 3])
    np.testing.assert_allclose(table["time_s"], [0, 1, 2], atol=1e-9)
    np.testing.assert_allclose(table["start_x"], [1, 3, 5])
    np.testing.assert_allclose(table["goal_x"], [0, 1, 2])
    np.testing.assert_allclose(table["settle_time_s"], SETTLED_AFTER, atol=1e-9)
    entry = json.loads((out / "summary.json").read_text())["run"]
    assert [row["settle_time_s"] for row in entry["goals"]] == pytest.approx(SETTLED_AFTER)
    assert entry["goal"] == 3 and entry["goals"][2].items() >= entry["metrics"].items()
    page = (out / "report.html").read_text()
    assert told in page and "<h2>run, goal 3</h2>" in page
    rows = [re.findall(r"<td>([^<]*)</td>", row) for row in page.split("<tr>") if "<td>" in row]
    goals = rows[-3:]
    assert [row[0] for row in goals] == ["1", "2", "3"]
    assert [row[4] for row in goals] == ["0.47 s", "0.53 s", "0.58 s"]
    assert len(np.genfromtxt(out / "motion.csv", delimiter=",", names=True)) == 300


def test_report_says_what_was_asked_for_and_judges_that(tmp_path, capsys, one_figure) -> None:
    bag, out = tmp_path / "run", tmp_path / "out"
    turned = [changed(entry, edit=lambda message: setattr(message.pose, "orientation", OVER))
              if entry[0] == "/pose" else entry for entry in approach(2)]
    goals = [entry for entry in turned if entry[0] != "/pose"]
    kinds = zip(goals, ("any", "any_heading"), strict=True)
    write_own(bag, in_order(*turned, *(demand(goal, kind) for goal, kind in kinds)))
    assert main([str(bag), "--out", str(out), "--goal", "all", "--csv", "--parquet"]) == 0
    printed = capsys.readouterr().out
    assert "run, goal 1: settling time (error < 1e-2) 0.47 s\n" in printed
    assert "run, goal 1: final angle free\n" in printed
    assert "run, goal 2: settling time (error < 1e-2) not settled\n" in printed
    assert "run, goal 2: final angle 180 deg, any heading\n" in printed
    header, *rows = (line.split(",") for line in (out / "goals.csv").read_text().splitlines())
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    assert columns["goal_orientation"] == ("any", "any_heading")
    assert columns["goal_q1"] == ("nan", "1")
    assert columns["final_orientation_error_rad"][0] == "nan"
    assert pq.read_table(out / "goals.parquet")["goal_orientation"].to_pylist()[0] == "any"
    first, _ = json.loads((out / "summary.json").read_text())["run"]["goals"]
    assert first["settled"] and first["final_orientation_error_rad"] is first["goal_q1"] is None
    errors = np.genfromtxt(out / "motion.csv", delimiter=",", names=True)
    assert np.isnan(errors["angle_error_rad"][:100]).all() and errors["error"][99] < 1e-3
    page = (out / "report.html").read_text()
    targets = "0, 0\nposition only", "1, 0\n1, 0, 0, 0\nany heading"
    assert all(f"<td>{target}</td>" in page for target in targets)


def test_page_has_the_animation_and_says_what_moved_the_sphere(tmp_path, one_figure) -> None:
    parameters = {"controller": {"robot.shell_radius": 0.3, "robot.max_rotor_speed": 80.0},
                  "simulator": {"plant": "rigid_body"}}
    out = tmp_path / "out"
    data = {f"parameters:/{node}": json.dumps(values) for node, values in parameters.items()}
    told = "/controller/status", STATUS, 6 * 10**9, status(strategy="paper", time_s=5.0)
    bag = write_own(tmp_path / "told", [*approach(1), told], data)
    unknown = "strategy unknown; robot of unknown size; plant unknown"
    told = "strategy paper; robot radius 0.3 m, rotors up to 80 rad/s; plant rigid_body"
    assert read_run(make_bag(tmp_path / "run")).setup == unknown
    assert main([str(bag), "--out", str(out), "--animation"]) == 0
    page = (out / "report.html").read_text()
    assert f"<p>{told}</p>" in page
    assert page.index("data:image/gif;base64,") < page.index("data:image/svg+xml;base64,")


def test_figures_of_each_goal_that_is_asked_for_of_bags_with_unique_names(
    tmp_path, capsys, one_figure
) -> None:
    bag, out = str(make_bag(tmp_path / "run" / "bag", goals=3)), tmp_path / "out"
    assert main([bag, bag, "--out", str(out), "--goal", "1", "2"]) == 0
    assert "3 goals; figures of goals 1, 2; --goal" in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary) == {"run_1", "run_2"} and summary["run_2"]["goal"] == 2
    assert summary["run_2"]["metrics"]["settle_time_s"] == pytest.approx(0.53, abs=1e-9)
    drawn = {file.name for file in out.glob("*.png")}
    expected = {f"run_{bag}_goal_{goal}_value.png" for bag in (1, 2) for goal in (1, 2)}
    assert drawn == expected | {"comparison.png"}


def test_goal_that_a_bag_does_not_have_is_refused(tmp_path, capsys) -> None:
    bag = make_bag(tmp_path / "run", goals=3)
    assert command(["report", str(bag), "--out", str(tmp_path / "out"), "--goal", "4"]) == 1
    assert "--goal: given 4, expected 1 to 3 or 'all'" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["bag", "--out", str(tmp_path), "--goal", "second"])


def test_topic_of_the_poses_can_be_given(tmp_path, capsys, one_figure) -> None:
    entries = [(entry[0].replace("/pose", "/optitrack/ball"), *entry[1:]) for entry in approach()]
    bag = write_own(tmp_path / "bag", without(entries, "active_goal"))
    assert command(["report", str(bag), "--out", str(tmp_path / "out")]) == 1
    assert "--pose-topic takes one of /optitrack/ball\n" in capsys.readouterr().err
    arguments = str(bag), "--out", str(tmp_path / "out"), "--pose-topic", "optitrack/ball"
    assert command(["report", *arguments]) == 0
    assert "report in" in capsys.readouterr().out


def test_report_of_a_run_without_a_goal_says_so(tmp_path, capsys, one_figure) -> None:
    out = tmp_path / "out"
    bag = make_bag(tmp_path / "run", goals=0)
    assert main([str(bag), "--out", str(out), "--csv"]) == 0
    assert "Without a goal there are no metrics" in (out / "report.html").read_text()
    printed = capsys.readouterr()
    assert "goal_pose and active_goal are missing" in printed.err
    assert "run: no metrics, as no goal was in force at any pose; see the notes" in printed.out
    table = np.genfromtxt(out / "motion.csv", delimiter=",", names=True)
    assert np.all(np.isnan(table["error"])) and np.all(np.isfinite(table["x"]))


def test_error_names_the_file_that_cannot_be_written_and_numbers_are_kept(tmp_path) -> None:
    bag, out = make_bag(tmp_path / "run"), tmp_path / "out"
    ended = report(str(bag), "--out", str(out), "--csv", limit=35_000)
    assert ended.returncode == 1
    failed = out / "panels.png"
    assert ended.stderr.splitlines()[-1] == f"sphere_nmpc report: {failed}: File too large"
    assert "Traceback" not in ended.stderr and "run: final error" in ended.stdout
    kept = {"summary.json", *(f"{name}.csv" for name in ("motion", "solves", "goals"))}
    assert {file.name for file in out.iterdir()} == kept
