# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of any content are read, or refused in one line; machines that lack something."""

import os
import random
import resource
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from patience import PATIENCE
from recorded_bags import rolling_messages, write_own

from sphere_nmpc.child import python_command
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.lifetime import RunnableNode, run
from sphere_nmpc.ros.settings import ControllerNodeSettings
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.run_reader import read_run
from sphere_sim.scenario.csv_file import STATE_COLUMNS, ScenarioFileError, read_scenarios

HEADER = ",".join((*STATE_COLUMNS, "seed")).encode()
ROW = b"2,-3,1,0,0,0,0,0,0,1,0,0,7"
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(HEADER) + len(ROW)), st.binary(min_size=1, max_size=4))
def test_any_damage_to_scenarios_is_read_or_refused(tmp_path, place, damage) -> None:
    whole, path = HEADER + b"\n" + ROW, tmp_path / "damaged.csv"
    path.write_bytes(whole[:place] + damage + whole[place + 1 :])
    try:
        scenarios = read_scenarios(path)
    except ScenarioFileError as error:
        assert str(path) in str(error) and "given" in str(error) and "\n" not in str(error)
        return
    for scenario in scenarios:
        assert np.all(np.isfinite(scenario.start)) and np.all(np.isfinite(scenario.goal))
        assert np.linalg.norm(scenario.goal[2:]) == pytest.approx(1.0)


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return write_own(tmp_path_factory.mktemp("fuzz") / "bag", rolling_messages())


@pytest.mark.parametrize("name", ["metadata.yaml", "bag_0.mcap"])
@pytest.mark.parametrize("seed", range(12))
def test_any_damage_to_a_bag_is_read_or_refused(bag, tmp_path, name, seed) -> None:
    rng = random.Random(seed)
    copy = tmp_path / "bag"
    copy.mkdir()
    for file in bag.iterdir():
        data = bytearray(file.read_bytes())
        if file.name == name:
            kind = seed % 4
            if kind == 0:
                del data[rng.randrange(len(data)) :]
            elif kind == 1:
                place = rng.randrange(len(data))
                data[place : place + rng.randrange(1, 50)] = rng.randbytes(rng.randrange(50))
            else:
                for _ in range(1 if kind == 2 else 30):
                    data[rng.randrange(len(data))] = rng.randrange(256)
        (copy / file.name).write_bytes(data)
    try:
        run = read_run(copy)
    except BagError as error:
        assert str(copy) in str(error)
        return
    assert len(run.times) == len(run.states) > 0


class ShortNode(RunnableNode):
    """Node with the parameters of the controller, which ends as soon as it runs."""

    def __init__(self) -> None:
        super().__init__("controller")
        self.parameters.declare(ControllerNodeSettings())
        self.parameters.declare(RobotParameters(), "robot")
        self.parameters.warn_of_unknown()

    def work(self, executor) -> None:
        signal.raise_signal(signal.SIGTERM)
        executor.spin_once(timeout_sec=0.1)


def parameters(*lines: str) -> bytes:
    return "\n    ".join(["controller:\n  ros__parameters:", *lines]).encode()


@pytest.mark.parametrize(
    ("content", "starts"),
    [
        (parameters("strategy: paper", "unheard_of: [1, 2]"), True),
        (parameters("time_budget: .nan"), False),
        (parameters("max_iterations: 99999999999999999999999"), False),
        (parameters("robot: {shell_mass: !!python/object:os.system x}"), False),
        (parameters("robot: 1", "pose_timeout: [1, a]"), False),
        (parameters("strategy: |", "sample_period: 1e999"), False),
        (parameters("\t1"), False),
        (b"\xff\x00{]", False),
        (b"", True),
    ],
    ids=range(9),
)
def test_node_starts_with_a_parameter_file_or_reports_why_not(
    tmp_path, capfd, content, starts
) -> None:
    path = tmp_path / "any.yaml"
    path.write_bytes(content)
    code = run(ShortNode, ["--ros-args", "--params-file", str(path)], "")
    output = capfd.readouterr().err
    assert (code == 0) is starts and code in (0, 1, 2) and "Traceback" not in output
    assert starts or output.strip(), "a node that does not start prints the reason"


STUDY = ("study", "--draw", "2", "--seed", "1", "--duration", "1", "--jobs", "2", "--no-bound")


def test_study_without_a_home_and_with_few_files_has_its_results(tmp_path) -> None:
    program = "from sphere_sim.cli.main import main; sys.exit(main())"
    done = subprocess.run(
        python_command(program, *STUDY, "--out", str(tmp_path / "out")),
        # Not even root can create a folder there.
        env={**os.environ, "HOME": "/dev/null/home"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40)),
        capture_output=True, text=True, timeout=PATIENCE, cwd=tmp_path,
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert (tmp_path / "out" / "runs.csv").exists()
