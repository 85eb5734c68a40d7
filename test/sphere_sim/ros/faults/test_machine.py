# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Machines that lack something: some of them are tried, and complaints are not overheard."""

import resource
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from sphere_sim.ros.faults.machine import MACHINE_FAULTS
from sphere_sim.ros.faults.scratch import Ended, ScratchHome

IN_CI = ("machine_home_missing", "machine_endless_file", "machine_domain_misspelt")
"""Those that take some seconds; the others have tests of their own where their code is."""


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_CI)
def test_machine_is_survived(name) -> None:
    assert MACHINE_FAULTS[name].run().complaints == ()


def test_names_belong_to_the_group() -> None:
    assert all(name.startswith("machine_") for name in MACHINE_FAULTS)
    assert {fault.group for fault in MACHINE_FAULTS.values()} == {"machine"}


@pytest.mark.parametrize(
    ("ended", "told"),
    [
        (Ended(1, "no room\n", 1.0), "exit code 1, expected 0: no room"),
        (Ended(0, "Traceback (most recent call last)\nOSError\n", 1.0), "a traceback: OSError"),
        (Ended(0, "fine\n", 1.0), "nothing told 'room'"),
        (Ended(0, "no room\nno room\n", 1.0), "told 2 lines, expected 1: no room | no room"),
    ],
)
def test_what_differs_is_complained_about(ended, told) -> None:
    assert told in ended.faults(0, "room", lines=1)


def test_expected_end_is_nothing_to_complain_about() -> None:
    told = "sphere_nmpc: compiling the solver (once, about 3 s) ...\nno room\n"
    assert Ended(1, told, 1.0).faults(1, "room", lines=1) == []


def test_command_runs_in_a_home_of_its_own_with_its_limits(tmp_path) -> None:
    home = ScratchHome(tmp_path)
    limits = {resource.RLIMIT_FSIZE: 100}
    ended = home.run(["--version"], {"LANG": None}, limits, tmp_path / "version.txt")
    assert ended == Ended(0, "", ended.seconds)
    assert (tmp_path / "version.txt").read_text().startswith("sphere_nmpc ")
    environment = home.environment({"LANG": None, "CC": "gcc"})
    assert "LANG" not in environment and environment["CC"] == "gcc"
    assert Path(environment["HOME"]) == tmp_path / "home"


def test_command_that_is_left_is_ended(tmp_path) -> None:
    home = ScratchHome(tmp_path)
    began = time.monotonic()
    with home.running(["simulator"]) as node:
        assert node.wait_for(lambda: "ROS domain" in node.told, 60.0)
        pid = node.pid
    assert not Path(f"/proc/{pid}").exists() and time.monotonic() - began < 60.0
