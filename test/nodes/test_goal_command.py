# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal command with real nodes: what it prints and its exit code."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from patience import PATIENCE
from rclpy.executors import SingleThreadedExecutor
from ros_graph import started
from std_srvs.srv import SetBool, Trigger
from verb_process import start

from sphere_nmpc.child import Child, stop_together
from sphere_nmpc.control.goal_client import NavigatorSettings
from sphere_sim.ros.session import goal_command
from sphere_sim.ros.session.goal_command import main

pytestmark = pytest.mark.slow

FAR = ("300", "0", "--wait")
"""A goal that is not reached within a test."""


def test_missing_controller_exits_with_1(capsys) -> None:
    assert main(["1", "2", "--timeout", "0.3"]) == 1
    assert "no controller was ready within 0.3 s" in capsys.readouterr().err


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
    with started("controller", "-p", "use_sim_time:=true", "-p", "goal_memory:=0.0"):
        end, told = time.monotonic() + PATIENCE, ""
        while "no publisher" not in told:
            assert time.monotonic() < end, told
            assert main(["1", "0", "--yaw", "1", "--timeout", str(PATIENCE)]) == 0
            told = capsys.readouterr().out
    assert told.startswith(
        "goal x 1 y 0 m, quaternion wxyz [0.8776, 0.0, 0.0, 0.4794], rotation vector "
        "[0.0, 0.0, 57.3] deg: in force, but the controller waits: 'no clock: "
    )


class Robot:
    """Simulator and controller as processes, and commands that wait for the arrival."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        at_origin = ("-p", "initial_state:=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]")
        self.simulator = start(folder, "simulator", "--ros-args", *at_origin)
        self.start_controller()
        self.command: Child | None = None

    def start_controller(self) -> None:
        """Start the controller, which resumes the goals of one before."""
        self.controller = start(
            self._folder, "controller", "--ros-args", "-p", "use_sim_time:=true",
            "-p", "goal_memory:=30.0",
        )

    @property
    def printed(self) -> str:
        """What the command has printed."""
        return (self._folder / "goal.log").read_text(encoding="utf-8")

    def begin(self, *arguments: str) -> None:
        """Start a command, and wait until it reports its progress."""
        self.command = start(self._folder, "goal", *arguments, "--timeout", str(PATIENCE))
        wait(lambda: " s left" in self.printed or self.command.code is not None)

    def code(self) -> int:
        """Return the exit code of the command."""
        assert self.command is not None
        return self.command.wait(PATIENCE)


def wait(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "time-out"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def goal_files(tmp_path_factory) -> Iterator[Path]:
    """Return an empty folder in which controllers keep their goals."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder


@pytest.fixture(scope="module")
def robot(tmp_path_factory, goal_files) -> Iterator[Robot]:
    robot = Robot(tmp_path_factory.mktemp("robot"))
    yield robot
    stop_together([robot.controller, robot.simulator])


def call(kind: type, name: str, request: object) -> None:
    """Call a service of the controller, beside a command that may run in this process."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("test", context=context)
    client = node.create_client(kind, f"controller/{name}")
    assert client.wait_for_service(PATIENCE)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    answer = client.call_async(request)
    executor.spin_until_future_complete(answer, PATIENCE)
    assert answer.result().success
    node.destroy_node()
    executor.shutdown()
    context.shutdown()


def test_command_waits_for_the_arrival_of_a_pose_a_point_and_several_goals(robot, capfd) -> None:
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


def test_interrupted_command_leaves_the_sphere_on_its_way_and_another_one_takes_over(
    robot, capsys
) -> None:
    robot.begin(*FAR)
    robot.command.send(signal.SIGINT)
    assert robot.code() == 1
    assert robot.printed.endswith(": interrupted; the sphere goes on to it\n")
    robot.begin(*FAR)
    assert main(["299", "0", "--timeout", str(PATIENCE)]) == 0
    printed = capsys.readouterr().out
    waits = ": in force, but the controller waits: the clock stands still: "  # on a busy machine
    progress = ": in force; /controller/status reports the progress\n"
    assert printed.endswith(progress) or waits in printed
    assert robot.code() == 1
    assert robot.printed.endswith(": another goal has taken over\n")


def test_command_cancels_on_interrupt_and_ends_where_the_controller_is_disabled(robot) -> None:
    robot.begin(*FAR, "--cancel-on-interrupt")
    robot.command.send(signal.SIGTERM)
    assert robot.code() == 1
    assert robot.printed.endswith(
        ": interrupted, cancelled; the sphere is at rest on its path\n"
    )
    robot.begin(*FAR)
    call(SetBool, "enable", SetBool.Request(data=False))
    assert robot.code() == 1
    assert robot.printed.endswith(
        ": the controller does not pursue it: disabled: ros2 service call /controller/enable "
        'std_srvs/srv/SetBool "{data: true}"\n'
    )
    call(SetBool, "enable", SetBool.Request(data=True))


def test_command_continues_with_a_restarted_controller(
    robot, goal_files, monkeypatch, capsys
) -> None:
    patient = NavigatorSettings(controller_timeout=PATIENCE)
    # A busy machine may need long to start it.
    monkeypatch.setattr(goal_command, "SETTINGS", patient)
    codes: list[int] = []
    printed = ""

    def wait_for_lines(number: int) -> None:
        nonlocal printed
        printed = ""

        def are_there() -> bool:
            nonlocal printed
            printed += capsys.readouterr().err
            return printed.count(" s left") >= number or bool(codes)

        wait(are_there)
        assert not codes, printed

    arguments = [*FAR, "--timeout", str(PATIENCE)]
    command = threading.Thread(target=lambda: codes.append(main(arguments)))
    command.start()
    wait_for_lines(1)
    begun = time.time()
    wait(lambda: any(file.stat().st_mtime > begun for file in goal_files.rglob("*.json")))
    robot.controller.kill()
    robot.start_controller()
    wait_for_lines(3)
    call(Trigger, "cancel", Trigger.Request())
    command.join(PATIENCE)
    assert codes == [1]
    assert ": cancelled at the controller" in capsys.readouterr().err


def test_command_ends_when_the_controller_is_gone(robot) -> None:
    robot.begin(*FAR)
    robot.controller.kill()
    assert robot.code() == 1
    assert "no status of the controller for 10 s" in robot.printed
