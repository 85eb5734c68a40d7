# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Start and end of a node's process: the last command of a controller is a ramp to rest."""

import fcntl
import os
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.child import END_SIGNALS
from sphere_nmpc.ros.conversions import hold_from_trajectory, pose_to_ros, stamp_to_ros
from sphere_nmpc.ros.lifetime import StopRequest
from sphere_sim.scenario.scenarios import PAPER_CASES

CASE = PAPER_CASES[1]
CONTROLLER = "import sys; from sphere_nmpc.ros.controller.node import main; sys.exit(main())"


def start(code: str, *arguments: str, **options: Any) -> subprocess.Popen:
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", *arguments], text=True, **{**streams, **options}
    )


def ramp_after(graph, end: Callable[[subprocess.Popen], object], **options: Any) -> None:
    """Check the last commands of a controller in motion that `end` ends."""
    trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
    commands = graph.collect(Float64MultiArray, "rotor_commands")
    controller = start(
        CONTROLLER, "-p", "use_sim_time:=true", "-p", "strategy:=paper", **options
    )
    try:
        goals = graph.publisher(PoseStamped, "goal_pose")
        poses = graph.publisher(PoseStamped, "pose")
        clock = graph.publisher(Clock, "/clock")
        goals.publish(pose_to_ros(CASE.goal, 0, 0.3))
        goals.wait_for_all_acked(Duration(seconds=5.0))
        began = time.monotonic()

        def pass_time() -> bool:
            now = round((time.monotonic() - began) * 5e9)
            poses.publish(pose_to_ros(CASE.start, now, 0.3))
            clock.publish(Clock(clock=stamp_to_ros(now)))
            if len(trajectories) < 3 or not commands:
                return False
            return bool(np.max(np.abs(commands[-1].data)) > 20.0)

        graph.until(pass_time)
        end(controller)
        graph.until(lambda: controller.poll() is not None)
        assert controller.returncode == 0
        graph.until(lambda: not np.any(commands[-1].data))
    finally:
        controller.kill()
        controller.wait()
    before, last = (hold_from_trajectory(message, 0) for message in trajectories[-2:])
    assert not last.speeds[-1].any()
    assert last.end - last.start <= 0.25 + 1e-6, "100 rad/s at 400 rad/s^2"
    np.testing.assert_allclose(last.speeds[0], before.at(last.start), atol=1e-6)
    steps = np.abs(np.diff([command.data for command in commands[-30:]], axis=0))
    assert np.max(steps) < 60.0, "the sampled ramp has no jump to zero"


@pytest.mark.parametrize(
    "signals",
    [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT] * 2, [signal.SIGQUIT]],
    ids=["ctrl-c", "sigterm", "ctrl-c twice", "ctrl-backslash"],
)
def test_last_command_is_a_ramp_to_rest(graph, signals) -> None:
    def send(controller: subprocess.Popen) -> None:
        for number in signals:
            controller.send_signal(number)
            graph.spin_for(0.02)

    ramp_after(graph, send)


def test_last_command_is_a_ramp_to_rest_when_the_terminal_is_closed(graph) -> None:
    """The kernel sends SIGHUP, and each later write to the terminal fails."""
    outside, terminal = os.openpty()
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), terminal)
    own_terminal = {"start_new_session": True, "preexec_fn": lambda: fcntl.ioctl(
        terminal, termios.TIOCSCTTY, 0
    )}
    ramp_after(graph, lambda _: os.close(outside), **streams, **own_terminal)
    os.close(terminal)


def test_node_runs_on_after_the_terminal_when_it_was_started_by_nohup(graph) -> None:
    node = start(CONTROLLER, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    graph.until(lambda: graph.probe.count_publishers("controller/status") > 0)
    node.send_signal(signal.SIGHUP)
    enabling = SetBool.Request(data=True)
    assert graph.call(SetBool, "controller/enable", enabling).success
    node.send_signal(signal.SIGTERM)
    assert node.wait(timeout=PATIENCE) == 0


def test_signal_ends_a_node_that_waits_for_messages(graph) -> None:
    node = start(CONTROLLER)
    graph.until(lambda: graph.probe.count_publishers("controller/status") > 0)
    node.send_signal(signal.SIGINT)
    assert node.wait(timeout=PATIENCE) == 0


FAILING = """
import sys
from sphere_nmpc.ros.lifetime import RunnableNode, run

class Failing(RunnableNode):
    def __init__(self):
        super().__init__("failing")
        self.times = 0

    def work(self, executor):
        self.times += 1
        if self.times == 300:
            print("again and again", flush=True)
        if self.times >= 300:
            return super().work(executor)
        raise ValueError("on demand")

sys.exit(run(Failing, None, ""))
"""


def test_work_that_fails_is_one_line_and_the_node_goes_on() -> None:
    node = start(FAILING, stdout=subprocess.PIPE)
    assert node.stdout.readline() == "again and again\n"
    node.send_signal(signal.SIGTERM)
    _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 0
    (line,) = (line for line in errors.splitlines() if "[INFO]" not in line)
    assert line.endswith("callback failed: ValueError 'on demand' (<string>, line 16)")


@pytest.fixture
def own_handlers() -> Iterator[None]:
    """Restore the signal handlers of the test session afterwards."""
    handlers = {number: signal.getsignal(number) for number in END_SIGNALS}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", END_SIGNALS)
def test_signal_wakes_a_node_that_waits_in_the_middleware(number, own_handlers) -> None:
    woken = threading.Event()
    with StopRequest() as stop:
        stop.wake = woken.set
        os.kill(os.getpid(), number)
        assert woken.wait(PATIENCE)
        assert stop.requested


@pytest.mark.parametrize(
    "arguments, code, words",
    [
        (["-p", "horizon:=0"], 2, "horizon: given 0, expected 1 to 60"),
        (["-p", "robot.shell_mass:=heavy"], 2, "robot.shell_mass: given 'heavy', expected"),
        (["--params-file", "absent.yaml"], 2, "cannot start: .* Error opening YAML file"),
    ],
)
def test_wrong_parameter_ends_the_node_with_one_line(arguments, code, words) -> None:
    node = start(CONTROLLER, *arguments)
    _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == code
    assert len(errors.strip().splitlines()) == 1
    assert re.search(words, errors)


def test_unknown_argument_is_named() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CONTROLLER, "strategy:=paper"],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "cannot start: given strategy:=paper, expected --ros-args -p strategy:=paper for a "
        "parameter, -r strategy:=paper for a remapping\n"
    )


def test_help_lists_topics_without_starting() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CONTROLLER, "--help"],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )
    assert done.returncode == 0
    assert "goal_pose" in done.stdout and "--ros-args" in done.stdout
