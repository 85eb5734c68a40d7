# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Start and end of a node's process: the last command of a controller is a ramp to rest."""

import fcntl
import gc
import os
import re
import signal
import subprocess
import sys
import termios
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.child import END_SIGNALS
from sphere_nmpc.ros.lifetime import GarbageCollection, RunnableNode, StopRequest, run
from sphere_nmpc.ros.messages import hold_from_trajectory, pose_to_ros, stamp_to_ros
from sphere_nmpc.ros.startup import RosArgumentsError, without_ros_arguments
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
    slowest = [command.data for command in commands if np.any(command.data)][-1]
    assert np.max(np.abs(slowest)) <= 400.0 * 0.01 + 1e-6, "the sampled ramp goes down to rest"


def test_last_command_is_a_ramp_to_rest_after_ctrl_c_also_twice(graph) -> None:
    def send(controller: subprocess.Popen) -> None:
        for _ in range(2):
            controller.send_signal(signal.SIGINT)
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


def test_hang_up_that_is_ignored_as_by_nohup_stays_ignored(own_handlers) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with StopRequest() as stop:
        os.kill(os.getpid(), signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN and not stop.requested


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["-p", "horizon:=0"], "horizon: given 0, expected 1 to 60"),
        (["--params-file", "absent.yaml"], "cannot start: .* Error opening YAML file"),
    ],
)
def test_wrong_parameter_ends_the_node_with_one_line(arguments, words) -> None:
    node = start(CONTROLLER, *arguments)
    _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 2
    assert len(errors.strip().splitlines()) == 1
    assert re.search(words, errors)


def test_help_lists_topics_without_starting(capsys) -> None:
    assert run(RunnableNode, ["--help"], "goal_pose") == 0
    assert capsys.readouterr().out == "goal_pose\n"


@pytest.mark.parametrize(
    ("words", "own"),
    [
        ("", ""),
        ("--port 8080 --ros-args -p strategy:=paper -r __ns:=/left", "--port 8080"),
        ("--ros-args --param a:=b --remap /clock:=/clock --log-level rcl:=debug -- 1 0", "1 0"),
    ],
)
def test_arguments_of_ros_are_left_out(words, own) -> None:
    assert without_ros_arguments(words.split()) == own.split()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("strategy:=paper", "given strategy:=paper, expected --ros-args -p strategy:=paper for a "
         "parameter, -r strategy:=paper for a remapping"),
        ("--ros-args -p a:=b -- strategy:=paper", "given strategy:=paper, expected --ros-args"),
        ("--ros-args --params_file a.yaml", "arguments after --ros-args: given ['--params_file', "
         "'a.yaml'], which ROS does not know"),
        ("--ros-args -p strategy", "Couldn't parse parameter override rule: '-p strategy'"),
    ],
)
def test_argument_that_ros_refuses_or_would_misread_is_named(words, told) -> None:
    with pytest.raises(RosArgumentsError) as caught:
        without_ros_arguments(words.split())
    assert told in str(caught.value)


class Cycle:
    """Object that refers to itself, so that its reference count never falls to zero."""

    def __init__(self) -> None:
        self.itself = self


def test_garbage_is_collected_at_its_intervals_and_only_then() -> None:
    with GarbageCollection(0.0) as garbage:
        assert not gc.isenabled()
        young, kept = weakref.ref(Cycle()), Cycle()
        old = weakref.ref(kept)
        garbage.collect_if_due(0.2)
        assert young() is not None
        garbage.collect_if_due(0.3)
        assert young() is None
        for second in range(1, 5):
            garbage.collect_if_due(float(second))
        del kept
        garbage.collect_if_due(290.0)
        assert old() is not None, "it has survived two collections of new objects"
        garbage.collect_if_due(301.0)
        assert old() is None
    assert gc.isenabled() and gc.get_freeze_count() == 0


SCHEDULING = """
import os, threading
from sphere_nmpc.ros.lifetime import schedule, lower_priority
{first}
threading.Thread(target=threading.Event().wait, daemon=True).start()
policies = lambda: {{os.sched_getscheduler(int(task)) for task in os.listdir("/proc/self/task")}}
usual = os.sched_getscheduler(0)
allowed = schedule(7)
assert not allowed or os.sched_getparam(0).sched_priority == 7
assert policies() == {{os.SCHED_FIFO if allowed else usual}}, policies()
schedule(0)
assert policies() == {{os.SCHED_OTHER if allowed else usual}}, policies()
before = os.nice(0)
lower_priority()
assert os.nice(0) == min(19, before + 5)
print(allowed)
"""


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="policies are Linux' own")
def test_priority_is_that_of_all_threads_or_of_none() -> None:
    def outcome(first: str = "") -> str:
        command = [sys.executable, "-c", SCHEDULING.format(first=first)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    assert outcome() in ("True", "False")
    if os.geteuid() == 0:
        assert outcome("os.setgid(65534); os.setuid(65534)") == "False"
