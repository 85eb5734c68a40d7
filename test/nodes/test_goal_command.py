# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal command with real nodes: what it prints and its exit code."""

import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from patience import PATIENCE, until
from ros_graph import running_graph, started
from std_srvs.srv import SetBool
from verb_process import start

from sphere_nmpc.process.child import stop_together
from sphere_sim.ros.session.goal_command import main

pytestmark = pytest.mark.slow

FAR = ("300", "0", "--wait")
"""A goal that is not reached within a test."""


def test_missing_controller_exits_with_1(capsys) -> None:
    assert main(["1", "2", "--timeout", "0.3"]) == 1
    assert "no controller was ready within 0.3 s" in capsys.readouterr().err
    assert main(["1", "2", "--timeout", "1.2"]) == 1
    *_, waiting, ended = capsys.readouterr().err.splitlines()
    found = "0 subscribers of /goal_pose, 0 publishers of /controller/status"
    assert waiting.endswith(f": waiting up to 1.2 s for a controller: {found}")
    assert f": no controller was ready within 1.2 s: {found}; is one" in ended


def test_goal_that_no_controller_confirms_exits_with_1(capsys, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.ros.session.goal_command._ANSWER_TIMEOUT", 0.0)
    with started("controller"):
        assert main(["1", "2", "--timeout", str(PATIENCE)]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.endswith(
        "the goal was sent but not confirmed on /controller/status within 0 s; the "
        "controller's log names the reason\n"
    )


def test_what_the_controller_waits_for_is_told_with_the_remedy(capsys, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.ros.session.goal_command._ANSWER_TIMEOUT", PATIENCE)
    with started("controller", use_sim_time=True):
        told = ""
        while "no publisher" not in told:
            assert main(["1", "0", "--yaw", "1", "--timeout", str(PATIENCE)]) == 0
            told = capsys.readouterr().out
    assert told.startswith(
        "goal x 1 y 0 m, quaternion wxyz [0.8776, 0.0, 0.0, 0.4794], rotation vector "
        "[0.0, 0.0, 57.3] deg: in force, but the controller waits: 'no clock: "
    )


class Robot:
    """Simulator and controller as processes, and a command that waits for the arrival."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        at_origin = ("-p", "initial_state:=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]")
        self.nodes = [start(folder, "simulator", "--ros-args", *at_origin),
                      start(folder, "controller", "--ros-args", "-p", "use_sim_time:=true")]

    def begin(self, *arguments: str) -> None:
        """Start a command, and wait until it reports its progress."""
        self.command = start(self._folder, "goal", *arguments, "--timeout", str(PATIENCE))
        until(lambda: " s left" in self.command.output or not self.command.running)

    def end(self) -> str:
        """Return what the command has printed when it has exited with 1."""
        assert self.command.wait(PATIENCE) == 1
        return self.command.output


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Iterator[Robot]:
    robot = Robot(tmp_path_factory.mktemp("robot"))
    yield robot
    stop_together(robot.nodes)


def enable(data: bool) -> None:
    with running_graph() as graph:
        assert graph.call(SetBool, "controller/enable", data=data).success


def test_command_waits_for_the_arrival_of_a_pose_a_point_several_goals_and_a_path(
    robot, tmp_path, capfd
) -> None:
    waiting = ("--wait", "--timeout", str(PATIENCE))
    assert main(["0.3", "0.2", *waiting]) == 0
    printed = capfd.readouterr()
    assert ": reached after " in printed.out and " mm, " in printed.out
    assert printed.err.endswith("at the goal\n") and " s left" in printed.err
    assert main(["0.2", "0.1", "--point", *waiting]) == 0
    printed = capfd.readouterr()
    assert printed.out.startswith("goal x 0.2 y 0.1 m, any orientation: reached after ")
    assert " deg" not in printed.out
    assert main(["0.3", "0.2", "--then", "0", "0", "90", "--degrees", *waiting]) == 0
    printed = capfd.readouterr()
    assert printed.out.startswith("2 goals, the last one x 0 y 0 m")
    assert "goal 2 of 2: " in printed.err.splitlines()[-1]
    assert main(["0", "0", "--yaw", "90", "--degrees", *waiting]) == 0, "already there"
    (tmp_path / "path.csv").write_text("x,y\n0,0\n0.6,0\n0.6,0.6\n")
    assert main(["--path", str(tmp_path / "path.csv"), *waiting]) == 0
    printed = capfd.readouterr()
    assert re.search(r"y 0.6 m: reached after .* mm, at most [\d.]+ mm off the path", printed.out)
    assert re.search(r" s left, +[\d.]+ mm off the path, ", printed.err)


def test_interrupted_command_leaves_the_sphere_on_its_way_and_another_one_takes_over(
    robot, capsys
) -> None:
    robot.begin(*FAR)
    robot.command.send(signal.SIGINT)
    assert robot.end().endswith(": interrupted; the sphere goes on to it\n")
    robot.begin(*FAR)
    assert main(["299", "0", "--timeout", str(PATIENCE)]) == 0
    printed = capsys.readouterr().out
    waits = ": in force, but the controller waits: the clock stands still: "  # on a busy machine
    progress = ": in force; /controller/status reports the progress\n"
    assert printed.endswith(progress) or waits in printed
    assert robot.end().endswith(": another goal has taken over\n")


def test_command_cancels_on_interrupt_and_ends_where_the_controller_is_disabled(robot) -> None:
    robot.begin(*FAR, "--cancel-on-interrupt")
    robot.command.send(signal.SIGTERM)
    assert robot.end().endswith(
        ": interrupted, cancelled; the sphere is at rest on its path\n"
    )
    robot.begin(*FAR)
    enable(False)
    assert robot.end().endswith(
        ": the controller does not pursue it: disabled: ros2 service call /controller/enable "
        'std_srvs/srv/SetBool "{data: true}"\n'
    )
    enable(True)
