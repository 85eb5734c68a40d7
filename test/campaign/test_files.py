# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of any content are read, or refused in one line that names the file."""

import random
import signal
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import make_state
from sphere_nmpc.quantity import quantities
from sphere_nmpc.ros.lifetime import RunnableNode, run
from sphere_nmpc.ros.messages import pose_message
from sphere_nmpc.ros.settings import ControllerNodeSettings
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.bag_writer import BagWriter
from sphere_sim.recording.run_reader import read_run
from sphere_sim.scenario.csv_file import STATE_COLUMNS, ScenarioFileError, read_scenarios

HEADER = ",".join((*STATE_COLUMNS, "seed")).encode()
ROW = b"2,-3,1,0,0,0,0,0,0,1,0,0,7"
CELLS = st.sampled_from(
    [b"", b"0", b"1", b"nan", b"-inf", b"1e400", b"1_0", b"0x1", b'"', b'"1', b"\xff", b"\x00",
     "٣".encode(), b"1;2", b" 1 ", b"-0", b"\r", b"'", b"1e6", b"99999999999999999999"]
)
SAME_FILE = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def read_or_refuse(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    try:
        scenarios = read_scenarios(path)
    except ScenarioFileError as error:
        assert str(path) in str(error) and "given" in str(error) and "\n" not in str(error)
        return
    for scenario in scenarios:
        assert np.all(np.isfinite(scenario.start)) and np.all(np.isfinite(scenario.goal))
        assert np.linalg.norm(scenario.goal[2:]) == pytest.approx(1.0)


@SAME_FILE
@given(rows=st.lists(st.lists(CELLS, min_size=11, max_size=14), max_size=3))
def test_any_cells_are_read_or_refused(tmp_path, rows) -> None:
    lines = [HEADER, ROW, *(b",".join(row) for row in rows)]
    read_or_refuse(tmp_path / "cells.csv", b"\n".join(lines))


@SAME_FILE
@given(st.integers(0, len(HEADER) + len(ROW)), st.binary(min_size=1, max_size=4))
def test_any_damage_to_scenarios_is_read_or_refused(tmp_path, place, damage) -> None:
    whole = HEADER + b"\n" + ROW
    read_or_refuse(tmp_path / "damaged.csv", whole[:place] + damage + whole[place + 1 :])


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz") / "bag"
    writer = BagWriter(folder)
    writer.add_topic("/pose", "geometry_msgs/msg/PoseStamped")
    for i in range(50):
        stamp = i * 10**9 + 5
        writer.write("/pose", stamp, pose_message(make_state((i, 0), (1, 0, 0, 0)), stamp, 0.3))
        if i % 10 == 0:
            writer.commit()
    writer.close()
    return folder


@pytest.mark.parametrize("name", ["metadata.yaml", "bag_0.mcap"])
@pytest.mark.parametrize("seed", range(20))
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


NAMES = st.sampled_from(
    [*quantities(ControllerNodeSettings()), *(f"robot.{n}" for n in quantities(RobotParameters())),
     "robot", "use_sim_time", "unheard_of", "a.b.c", "qos_overrides", "''", "~", "1", "sphere:"]
)
VALUES = st.one_of(
    st.integers(-(2**70), 2**70).map(str),
    st.floats().map(str),
    st.sampled_from(
        ["", "true", "no", "paper", "[]", "[1, 2.0]", "[1, a]", "{}", "{a: 1}", "'", '"x',
         "!!python/object:os.system x", "!!binary aGk=", "*x", "&x 1", ".nan", "-.inf", "0x1F",
         "1e999", "2026-01-01", "[[1]]", "|", "- 1", "\t1", "\u2028", "null"]
    ),
)


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


def parameter_file(values: dict[str, str]) -> bytes:
    lines = [f"    {name}: {value}" for name, value in values.items()]
    return "\n".join(["controller:", "  ros__parameters:", *lines]).encode()


@settings(SAME_FILE, max_examples=60)
@given(text=st.one_of(
    st.dictionaries(NAMES, VALUES, min_size=1, max_size=3).map(parameter_file),
    st.binary(max_size=80),
    st.text("{}[]:-#&*!|>'\"%@`, \n\tab1/", max_size=60).map(str.encode),
))
def test_node_starts_with_a_parameter_file_or_reports_why_not(tmp_path, capfd, text) -> None:
    path = tmp_path / "any.yaml"
    path.write_bytes(text)
    code = run(ShortNode, ["--ros-args", "--params-file", str(path)], "")
    output = capfd.readouterr().err
    assert code in (0, 1, 2) and "Traceback" not in output
    assert code == 0 or output.strip(), "a node that does not start prints the reason"
