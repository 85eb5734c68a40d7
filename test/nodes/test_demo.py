# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo: its arguments, its results, its page, and the end of its processes."""

import json
import os
import re
import select
import signal
import subprocess
import time
import urllib.request

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy")

from patience import PATIENCE

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.torque import largest_acceleration
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.cli.demo import parse
from sphere_sim.demo.plan import PROCESS_NOISE
from sphere_sim.demo.results import hints_of
from sphere_sim.evaluation.metrics import LOOSELY_SETTLED
from sphere_sim.recording.run_reader import read_run
from sphere_sim.ros.session.process_set import verb_command
from sphere_sim.scenario.scenarios import PAPER_CASES

DEMO = verb_command("demo", "--no-viewer")


def wait_for_progress(process: subprocess.Popen[str], least: float) -> float:
    """Return the simulated time of a line of progress that is later than `least` [s]."""
    for line in process.stdout:
        found = re.match(r"t +([\d.]+) s  distance", line)
        if found and float(found.group(1)) >= least:
            return float(found.group(1))
    raise AssertionError("the demo ended before it had made progress")


def test_case_4_has_noise_and_another_robot(tmp_path) -> None:
    plan = parse(["--case", "4", "--seed", "5", "--out", str(tmp_path)])
    assert plan.simulator["process_noise"] == PROCESS_NOISE
    assert plan.simulator["robot.shell_mass"] == pytest.approx(1.0, abs=0.03)
    assert plan.simulator["robot.shell_mass"] != 1.0
    assert "robot.max_rotor_speed" not in plan.simulator, "limits are no constants of a plant"
    assert plan.tolerance == LOOSELY_SETTLED
    assert plan.simulator == parse(["--case", "4", "--seed", "5"]).simulator
    others = [parse(["--case", str(case), "--rtf", "0"]) for case in (1, 2, 3)]
    assert not any("process_noise" in other.simulator for other in others)
    assert all(o.simulator["lockstep"] and o.controller["lockstep"] for o in others)


def test_settings_are_parameters_of_the_nodes_that_have_them_and_of_the_other_run() -> None:
    plan = parse([
        "--strategy", "paper", "--set", "horizon=8", "plant=rigid_body", "robot.shell_mass=1.5",
        "torque_limit=4", "slope=0.01", "floor=[[-9,-9],[9,-9],[9,9],[-9,9]]", "clearance=0.1",
    ])
    simulator, controller = plan.simulator, plan.controller
    edge = "[[-9,-9],[9,-9],[9,9],[-9,9]]"
    both = {"robot.shell_mass": 1.5, "floor": edge}
    expected = {"horizon": 8, "clearance": 0.1, "strategy": "paper", **both}
    assert controller.items() >= expected.items()
    expected = {"plant": "rigid_body", "slope": 0.01, "rigid_body.torque_limit": 4.0, **both}
    assert simulator.items() >= expected.items() and "clearance" not in simulator
    assert plan.conditions.controller.horizon == 8 and plan.robot.shell_mass == 1.5
    quiet = parse(["--case", "4", "--set", "process_noise=0"])
    assert "process_noise" not in quiet.simulator


@pytest.mark.parametrize("wrong", [
    ["--rtf", "-1"], ["--goal", "0", "0", "1", "1", "0", "0"], ["--set", "horizon"],
    ["--set", "nothing=1"], ["--set", "seed=1"], ["--set", "pose_source=odometry"],
    ["--set", "horizon=8", "horizon=9"], ["--set", "robot.shell_mass=-1"],
])
def test_wrong_arguments_exit_with_2(wrong) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse(wrong)


@pytest.mark.parametrize(("missed", "reported", "hints"), [
    (0.0, "", ""),
    (float("nan"), "", ""),
    (41.0, "", "17 % of the sampling instants missed: --rtf 0 lets time wait for the controller"),
    (0.0, "'no progress: over'", "'no progress: over'"),
    (41.0, "'no progress'", "17 % of the sampling instants missed: --rtf 0 lets time wait for the "
     "controller; 'no progress'"),
])
def test_a_run_that_fails_tells_what_is_known(missed: float, reported: str, hints: str) -> None:
    plan = parse(["--case", "3", "--rtf", "5"])
    period = ControllerSettings(strategy=plan.strategy).control_period
    assert hints_of(plan, missed, reported, 241.0 * period) == hints


@pytest.mark.slow
def test_a_run_that_fails_tells_so_in_one_line_and_exits_with_1(tmp_path) -> None:
    done = subprocess.run(
        [*DEMO, "--case", "1", "--rtf", "0", "--duration", "1", "--no-compare",
         "--out", str(tmp_path / "out")],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("demo: ")]
    expected = r"demo: not at the goal after [123]\.\d s: error [\d.]+, "
    expected += r"expected below 0\.01 for a sample period"
    assert re.fullmatch(expected, line)


@pytest.mark.slow
def test_case_1_arrives_and_leaves_its_folder(tmp_path) -> None:
    folder = tmp_path / "out [/b]"
    done = subprocess.run(
        [*DEMO, "--rtf", "0", "--out", str(folder)], capture_output=True, text=True,
        timeout=PATIENCE, check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    output = done.stdout
    assert "settling time" in output and str(folder) in output
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["arrived"] and summary["metrics"]["settled"]
    assert 5.0 < summary["metrics"]["settle_time_s"] < 6.5
    assert summary["metrics"]["final_error"] < 1e-4
    assert 12.0 < summary["compared_with"]["paper"]["settle_time_s"] < 13.0
    # No more than a motion within the limits of speed and acceleration may need.
    torque = summary["metrics"]["max_rotor_torque_nm"]
    motors = RobotParameters(max_rotor_torque=torque, max_rotor_acceleration=1e6)
    assert largest_acceleration(motors) < RobotParameters.max_rotor_acceleration
    assert summary["metrics"]["max_rotor_speed"] <= 100.0 + 1e-9
    for figure in ("panels.png", "panels.svg", "comparison.png"):
        assert (folder / figure).stat().st_size > 20_000
    assert "time_optimal" in output and "paper" in output
    run = read_run(folder / "bag")
    assert run.notes == () and run.goals.times[0] < 0.05
    np.testing.assert_allclose(run.states[0], PAPER_CASES[1].start, atol=1e-12)


@pytest.mark.slow
def test_signal_leaves_no_process_and_a_readable_bag(tmp_path) -> None:
    folder = tmp_path / "out"
    with subprocess.Popen(
        [*DEMO, "--out", str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        shown = wait_for_progress(process, 0.5)
        nodes = psutil.Process(process.pid).children(recursive=True)
        assert len(nodes) == 4, "three nodes, and the controller's worker"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130 and "Traceback" not in errors
    # Besides, rclpy may warn of a coroutine that the interrupt kept it from running.
    (told,) = [line for line in errors.splitlines() if "interrupted" in line]
    assert str(folder / "bag") in told
    assert not [node for node in nodes if node.is_running()]
    assert read_run(folder / "bag").times[-1] >= shown - 0.1


@pytest.mark.slow
def test_demo_shows_its_page_and_runs_on_until_enter(tmp_path) -> None:
    pytest.importorskip("viser")
    own, other = os.openpty()
    demo = subprocess.Popen(
        verb_command("demo", "--case", "3", "--no-compare", "--out", str(tmp_path / "out")),
        stdin=other, stdout=other, stderr=other,
        env={**os.environ, "TERM": "dumb", "COLUMNS": "200"},
    )
    os.close(other)
    output, end = "", time.monotonic() + PATIENCE
    try:
        while "the nodes run on" not in output:
            assert time.monotonic() < end and demo.poll() is None, output
            if select.select([own], [], [], 0.1)[0]:
                output += os.read(own, 65536).decode(errors="replace")
        children = psutil.Process(demo.pid).children(recursive=True)
        assert len(children) == 4, "three nodes, as the recording is over, and a worker"
        assert (tmp_path / "out" / "summary.json").exists()
        address = re.search(r"http://127\.0\.0\.1:\d+/\?token=[\w-]+(?=[\s\x1b])", output).group()
        with urllib.request.urlopen(address, timeout=PATIENCE) as page:
            assert page.status == 200
        os.write(own, b"\n")
        assert demo.wait(PATIENCE) == 0
    finally:
        if demo.poll() is None:
            demo.terminate()
            demo.wait(PATIENCE)
        os.close(own)
    assert not [child for child in children if child.is_running()]
