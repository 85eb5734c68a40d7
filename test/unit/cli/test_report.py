# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Reports of bags: files, page, and errors for bags that cannot be read."""

import json
import os
import re
import resource
import subprocess
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from patience import PATIENCE
from recorded_bags import (
    POSE,
    STATUS,
    Entry,
    changed,
    demand,
    diagnostics,
    estimated,
    goal_at,
    in_order,
    make,
    momentum_messages,
    pose,
    run_messages,
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

FIGURES = report_files.FIGURES


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


SETTLED_AFTER = (0.47, 0.53, 0.58)
"""Settling times of the goals of `approach` [s]."""


class Report:
    """What the report of one bag has printed and written."""

    def __init__(self, out: Path, printed: str, warned: str) -> None:
        self.printed, self.warned, self.out = printed, warned, out
        self.page = (out / "report.html").read_text()
        self.summary = json.loads((out / "summary.json").read_text())

    def table(self, name: str) -> np.ndarray:
        return np.genfromtxt(self.out / f"{name}.csv", delimiter=",", names=True)


@pytest.fixture
def make_report(tmp_path, capsys, monkeypatch) -> Callable[..., Report]:
    """Return a function that reports a bag of these entries, with one figure of each run.

    Drawing takes long.
    """
    monkeypatch.setattr(report_files, "FIGURES", {"value": FIGURES["value"]})

    def report(
        entries, *arguments: str, custom: Mapping[str, str] = {}, copies: int = 1
    ) -> Report:
        bag, out = write_own(tmp_path / "run", entries, custom), tmp_path / "out"
        assert main([*copies * [str(bag)], "--out", str(out), *arguments]) == 0
        return Report(out, *capsys.readouterr())

    return report


def report_in_a_process(*arguments: str, limit: int | None = None, **environment: str):
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


def test_report_of_one_bag_is_complete_also_outside_of_locale_and_notebook(tmp_path) -> None:
    bag, out = write_own(tmp_path / "a&büg" / "bag", approach()), tmp_path / "örep"
    ended = report_in_a_process(
        str(bag), "--out", str(out), "--csv", LC_ALL="C", PYTHONUTF8="0",
        PYTHONCOERCECLOCALE="0", PYTHONIOENCODING="ascii",
        MPLBACKEND="module://backend_of_the_kernel_of_a_notebook",
    )
    assert ended.returncode == 0, ended.stderr
    assert "settling time" in ended.stdout and "joint_states is missing" in ended.stderr
    for name in FIGURES:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (out / f"{name}.svg").read_text()
    report = Report(out, ended.stdout, ended.stderr)
    table = report.table("motion")
    np.testing.assert_allclose(table["x"], np.exp(-np.arange(100) / 10.0), rtol=1e-12)
    metrics = report.summary["a&büg"]["metrics"]
    assert metrics["settled"] and metrics["settle_time_s"] == pytest.approx(0.47, abs=1e-9)
    assert metrics["max_rotor_speed"] is None
    assert report.page.count("<td>0.47 s</td>") == 1, "its only goal has no table of the same"
    sources = re.findall(r'(?:src|href)="([^"]*)"', report.page)
    assert len(sources) == len(FIGURES)
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)
    assert "a&amp;büg" in report.page and "http" not in re.sub(r'src="[^"]*"', "", report.page)


def test_errors_of_odometry_are_reported(make_report) -> None:
    report = make_report(estimated(run_messages()))
    assert (report.out / "odometry.svg").exists()
    assert "odometry, error at the end 5 mm, 4.58 deg" in " ".join(report.printed.split())
    found = report.summary["run"]
    assert found["odometry_position_error_m"] == pytest.approx(5e-3)
    assert found["odometry_heading_error_deg"] == pytest.approx(np.degrees(0.08))
    assert "odometry, error at the end" in report.page


def test_momentum_and_pushes_are_reported(make_report) -> None:
    report = make_report(momentum_messages())
    assert (report.out / "momentum.svg").exists()
    assert "run: push 1 0.559 N s at 1 s" in report.printed
    assert "momentum at the end, estimated 0.168 N m s" in report.printed
    momentum = report.summary["run"]["momentum"]
    (push,) = momentum["pushes"]
    assert momentum["end_nms"] == pytest.approx([0.075, 0.15, 0.0])
    assert push["impulse_ns"] == [0.5, -0.25] and push["time_s"] == pytest.approx(1.0)


COUNTS = [
    diagnostics(10**9 * i, name, wall_touched=count) for i, name, count in (
        (2, "simulator: commands", 1), (3, "second/simulator: commands", 9),
        (4, "simulator: commands", 3), (4, "simulator: clock", 7),
    )
]
"""Contacts that a simulator counts, whose walls stop the sphere before."""


@pytest.mark.parametrize(
    ("least", "counts", "contacts", "first"),
    # The front of the sphere is at the wall, 1 m, after 3.5 s.
    [(0.1, [], 0, None), (-0.1, [], 1, 3.5), (0.1, COUNTS, 3, 1)],
)
def test_clearance_is_reported_and_touches_are_told_first(
    make_report, least, counts, contacts, first
) -> None:
    report = make_report(in_order(*walled_messages(least), *counts), "--csv")
    assert f"run: least clearance {1e3 * least:g} mm" in report.printed
    told = f"{contacts}, the first at {first} s" if contacts else "0"
    assert f"touches of what is occupied {told}\n" in report.printed
    floor = report.summary["run"]["floor"]
    assert floor["least_clearance_m"] == pytest.approx(least, abs=1e-6)
    assert floor["contacts"] == contacts
    assert floor["first_contact_s"] == pytest.approx(first, abs=0.021)
    assert np.min(report.table("motion")["clearance_m"]) == pytest.approx(least, abs=1e-6)
    assert (report.out / "clearance.svg").exists()
    alarm = "run: the sphere touched what is occupied on the floor: "
    assert (f"{alarm}{told}" in report.page) is (alarm in report.page) is bool(contacts)


OVER = make("geometry_msgs/msg/Quaternion", x=1.0, y=0.0, z=0.0, w=0.0)


def test_each_goal_has_a_row_and_is_judged_by_what_was_asked_for(make_report) -> None:
    """The sphere is upside down, where the first goal asks for nothing and the others for more."""
    turned = [changed(entry, edit=lambda message: setattr(message.pose, "orientation", OVER))
              if entry[0] == "/pose" else entry for entry in approach(3)]
    goals = [entry for entry in turned if entry[0] != "/pose"]
    kinds = ["any", "full", "any_heading"]
    asked = [demand(goal, kind) for goal, kind in zip(goals, kinds, strict=True)]
    report = make_report(in_order(*turned, *asked), "--csv")
    told = "3 goals; figures of goal 3; --goal 1 2 ... or --goal all for others"
    assert f"run: {told}\n" in report.printed and "run, goal 1: " not in report.printed
    assert "run, goal 3: settling time (error < 1e-2) not settled\n" in report.printed
    assert "run, goal 3: final angle 180 deg, any heading\n" in report.printed
    table, (_, *rows) = report.table("goals"), (report.out / "goals.csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows] == kinds
    nan = np.nan
    for name, expected in {
        "goal": [1, 2, 3], "time_s": [0, 1, 2], "start_x": [1, 3, 5], "goal_x": [0, 1, 2],
        "goal_q1": [nan, 1, 1], "settle_time_s": [SETTLED_AFTER[0], nan, nan],
        "final_orientation_error_rad": [nan, np.pi, np.pi],
    }.items():
        np.testing.assert_allclose(table[name], expected, rtol=1e-7, atol=1e-9)
    entry = report.summary["run"]
    assert entry["goal"] == 3 and entry["goals"][2].items() >= entry["metrics"].items()
    first = entry["goals"][0]
    assert first["settled"] and first["final_orientation_error_rad"] is first["goal_q1"] is None
    motion = report.table("motion")
    assert len(motion) == 300 and motion["error"][99] < 1e-3
    assert np.isnan(motion["angle_error_rad"][:100]).all()
    assert told in report.page and "<h2>run, goal 3</h2>" in report.page
    rows = [
        re.findall(r"<td>([^<]*)</td>", row) for row in report.page.split("<tr>") if "<td>" in row
    ][-3:]
    assert [row[0] for row in rows] == ["1", "2", "3"]
    assert [row[4] for row in rows] == ["0.47 s", "not settled", "not settled"]
    for target in ("0, 0\nposition only", "2, 0\n1, 0, 0, 0\nany heading"):
        assert f"<td>{target}</td>" in report.page


@pytest.mark.filterwarnings("error")
def test_goal_in_force_at_the_last_pose_alone_is_drawn_without_a_warning(tmp_path, capsys) -> None:
    last = 5 * 10**9 + 99 * 10_000_000
    goal = changed(goal_at(0.0, 0.0), stamp=last, log=last)
    bag, out = write_own(tmp_path / "run", in_order(*approach(0), goal)), tmp_path / "out"
    assert main([str(bag), "--out", str(out)]) == 0
    assert "Warning" not in capsys.readouterr().err and (out / "error.png").exists()


def test_page_has_the_animation_and_says_what_moved_the_sphere(tmp_path, make_report) -> None:
    parameters = {"controller": {"robot.shell_radius": 0.3, "robot.max_rotor_speed": 80.0},
                  "simulator": {"plant": "rigid_body"}}
    custom = {f"parameters:/{node}": json.dumps(values) for node, values in parameters.items()}
    told = "/controller/status", STATUS, 6 * 10**9, status(strategy="paper", time_s=5.0)
    page = make_report([*approach(), told], "--animation", "--goal", "all", custom=custom).page
    setup = "strategy paper; robot radius 0.3 m, rotors up to 80 rad/s; plant rigid_body"
    assert f"<p>{setup}</p>" in page
    assert page.index("data:image/gif;base64,") < page.index("data:image/svg+xml;base64,")
    unknown = "strategy unknown; robot of unknown size; plant unknown"
    assert read_run(write_own(tmp_path / "unknown", approach())).setup == unknown


def test_figures_of_each_goal_that_is_asked_for_of_bags_with_unique_names(make_report) -> None:
    entries = in_order(*approach(3), demand(goal_at(0.0, 0.0), "any"))
    report = make_report(entries, "--goal", "1", "2", copies=2)
    assert "run_2, goal 1: final angle free\n" in report.printed
    assert "3 goals; figures of goals 1, 2; --goal" in report.printed
    assert set(report.summary) == {"run_1", "run_2"}
    second = report.summary["run_2"]
    assert second["goal"] == 2
    assert second["metrics"]["settle_time_s"] == pytest.approx(SETTLED_AFTER[1], abs=1e-9)
    drawn = {file.name for file in report.out.glob("*.png")}
    expected = {f"run_{bag}_goal_{goal}_value.png" for bag in (1, 2) for goal in (1, 2)}
    assert drawn == expected | {"comparison.png"}


CAPTURED = [(entry[0].replace("/pose", "/optitrack/ball"), *entry[1:]) for entry in approach()]


@pytest.mark.parametrize(
    ("entries", "arguments", "told"),
    [
        (without(CAPTURED, "active_goal"), [], "--pose-topic takes one of /optitrack/ball\n"),
        (without(CAPTURED, "active_goal"), ["--pose-topic", "optitrack/ball", "--goal", "1"],
         "--goal: given 1, expected none, as it holds no goal"),
        (approach(3), ["--goal", "4"], "--goal: given 4, expected 1 to 3 or 'all'"),
    ],
    ids=["several topics", "no goal", "another goal"],
)
def test_what_a_bag_does_not_have_is_refused(tmp_path, capsys, entries, arguments, told) -> None:
    bag = write_own(tmp_path / "bag", entries)
    assert command(["report", str(bag), "--out", str(tmp_path / "out"), *arguments]) == 1
    assert told in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["bag", "--out", str(tmp_path), "--goal", "second"])


def test_report_of_poses_alone_says_that_there_is_no_goal_and_nothing_of_a_floor(
    make_report
) -> None:
    report = make_report(approach(0), "--csv")
    assert "Without a goal there are no metrics" in report.page
    assert "goal_pose and active_goal are missing" in report.warned
    assert "run: no metrics, as no goal was in force at any pose; see the notes" in report.printed
    table = report.table("motion")
    assert np.all(np.isnan(table["error"])) and np.all(np.isfinite(table["x"]))
    texts = [report.printed, report.warned] + [
        file.read_text() for file in report.out.iterdir() if file.suffix != ".png"
    ]
    assert not any(word in text for word in ("clearance", "occupied") for text in texts)


def test_error_names_the_file_that_cannot_be_written_and_numbers_are_kept(tmp_path) -> None:
    bag, out = write_own(tmp_path / "run", approach()), tmp_path / "out"
    ended = report_in_a_process(str(bag), "--out", str(out), "--csv", limit=35_000)
    assert ended.returncode == 1
    failed = out / "panels.png"
    assert ended.stderr.splitlines()[-1] == f"sphere_nmpc report: {failed}: File too large"
    assert "Traceback" not in ended.stderr and "run: final error" in ended.stdout
    kept = {"summary.json", *(f"{name}.csv" for name in ("motion", "solves", "goals"))}
    assert {file.name for file in out.iterdir()} == kept
