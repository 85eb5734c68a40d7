# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter files of any content: a node starts, or reports in one line why it does not."""

import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantities
from sphere_nmpc.ros.lifetime import RunnableNode, run
from sphere_nmpc.ros.settings import ControllerNodeSettings

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


def starts_or_reports(path: Path, text: bytes, capfd) -> None:
    path.write_bytes(text)
    code = run(ShortNode, ["--ros-args", "--params-file", str(path)], "")
    output = capfd.readouterr().err
    assert code in (0, 1, 2)
    assert "Traceback" not in output
    if code:
        assert output.strip(), "a node that does not start prints the reason"


FILES = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@FILES
@given(values=st.dictionaries(NAMES, VALUES, min_size=1, max_size=3))
def test_any_values(tmp_path, capfd, values) -> None:
    lines = ["controller:", "  ros__parameters:"]
    lines += [f"    {name}: {value}" for name, value in values.items()]
    starts_or_reports(tmp_path / "values.yaml", "\n".join(lines).encode(), capfd)


@FILES
@given(text=st.one_of(
    st.binary(max_size=80), st.text("{}[]:-#&*!|>'\"%@`, \n\tab1/", max_size=60).map(str.encode)
))
def test_any_text(tmp_path, capfd, text) -> None:
    starts_or_reports(tmp_path / "any.yaml", text, capfd)


@pytest.mark.parametrize("missing", ["none.yaml", "."])
def test_file_that_cannot_be_read(tmp_path, capfd, missing) -> None:
    code = run(ShortNode, ["--ros-args", "--params-file", str(tmp_path / missing)], "")
    output = capfd.readouterr().err
    assert code == 2 and "Traceback" not in output and "cannot start" in output
