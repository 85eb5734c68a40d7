# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The test of the sensors over DDS."""

import pytest
from patience import PATIENCE
from ros_graph import started

from sphere_sim.cli.main import main

pytestmark = pytest.mark.slow

SELF_TEST = "estimate", "--self-test", "3", "--ros-args", "-p", "use_sim_time:=true"
OF_TIME = "rate", "stamps"
"""Ends of the names of checks whose verdict depends on how busy the machine is."""


def test_sensors_of_a_simulator_that_stands_still_pass(capsys, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.ros.session.sensor_listener._PATIENCE", PATIENCE)
    with started("simulator"):
        main(SELF_TEST)
    *lines, result = capsys.readouterr().out.splitlines()
    found = {line[6:26].strip(): line[:4] for line in lines}
    assert {f"{name} {kind}" for name in ("imu", "joint_states", "pose") for kind in OF_TIME} < {
        *found
    }
    others = {name: it for name, it in found.items() if not name.endswith(OF_TIME)}
    assert set(others) == {
        "imu readings", "imu rest", "specific force", "up", "gyro bias", "gyro noise",
        "accelerometer noise", "rotor speeds", "rotor angles", "pose noise",
    }
    assert set(others.values()) == {"PASS"}
    assert "16 checks" in result


def test_robot_without_an_imu_fails(capsys, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.ros.session.sensor_listener._PATIENCE", 0.5)
    assert main(SELF_TEST[:3]) == 1
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("FAIL  imu rate             given 0 messages, expected 100 Hz")
    assert printed[-1] == "FAIL: imu rate; 2 checks, 1 warning"
