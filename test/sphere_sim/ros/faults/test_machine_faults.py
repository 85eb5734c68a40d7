# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the machine: some of them are tried, and wrong results are complained about."""

import resource
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from sphere_sim.faults.catalogue import FAULTS, chosen
from sphere_sim.ros.faults.machine_faults import MACHINE_FAULTS
from sphere_sim.ros.faults.scratch_home import CommandResult, ScratchHome

IN_CI = ("machine_home_missing", "machine_endless_file", "machine_domain_misspelt")
"""Those that take some seconds; the others have tests of their own where their code is."""


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_CI)
def test_machine_is_survived(name) -> None:
    assert MACHINE_FAULTS[name].run().complaints == ()


def test_faults_of_the_machine_are_selected_by_their_group() -> None:
    known = [*FAULTS.values(), *MACHINE_FAULTS.values()]
    assert chosen(known, ["machine"]) == list(MACHINE_FAULTS.values())
    assert not FAULTS.keys() & MACHINE_FAULTS.keys()


@pytest.mark.parametrize(
    ("code", "errors", "complaint"),
    [
        (1, "no room\n", "exit code 1, expected 0: no room"),
        (0, "Traceback (most recent call last)\nOSError\n", "a traceback: OSError"),
        (0, "fine\n", "'room' was not printed"),
        (0, "no room\nno room\n", "printed 2 lines, expected 1: no room | no room"),
    ],
)
def test_differences_from_the_expected_end_are_complained_about(code, errors, complaint) -> None:
    assert complaint in CommandResult(code, errors, 1.0).complaints(0, "room", lines=1)


def test_expected_end_gives_no_complaint() -> None:
    errors = "sphere_nmpc: compiling the solver (once, about 3 s) ...\nno room\n"
    assert CommandResult(1, errors, 1.0).complaints(1, "room", lines=1) == []


def test_command_runs_in_a_home_of_its_own_with_its_limits(tmp_path) -> None:
    home = ScratchHome(tmp_path)
    limits = {resource.RLIMIT_FSIZE: 100}
    ended = home.run(["--version"], {"LANG": None}, limits, tmp_path / "version.txt")
    assert ended == CommandResult(0, "", ended.seconds)
    assert (tmp_path / "version.txt").read_text().startswith("sphere_nmpc ")
    environment = home.environment({"LANG": None, "CC": "gcc"})
    assert "LANG" not in environment and environment["CC"] == "gcc"
    assert Path(environment["HOME"]) == tmp_path / "home"


def test_limit_of_file_sizes_leaves_no_truncated_bytecode(tmp_path) -> None:
    # Some versions of Python write it, and fail to load it afterwards.
    bytecode, limits = tmp_path / "bytecode", {resource.RLIMIT_FSIZE: 100}
    ended = ScratchHome(tmp_path).run(
        ["--version"], {"PYTHONPYCACHEPREFIX": str(bytecode)}, limits, tmp_path / "version.txt"
    )
    assert ended.code == 0 and not list(bytecode.rglob("*.pyc"))


def test_command_ends_with_its_context(tmp_path) -> None:
    home = ScratchHome(tmp_path)
    with home.running(["simulator"]) as node:
        assert node.wait_for(lambda: "ROS domain" in node.errors)
        pid = node.pid
    assert not Path(f"/proc/{pid}").exists()
