# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Start and end of a node's process: the last command of a controller is a ramp to rest."""

import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rclpy.duration import Duration
from rclpy.serialization import serialize_message
from ros_graph import started
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.process.child import Child, python_command
from sphere_nmpc.ros.cdr import hold_and_stamp
from sphere_nmpc.ros.messages import pose_to_ros, stamp_to_ros
from sphere_nmpc.ros.startup import RosArgumentsError, without_ros_arguments
from sphere_sim.ros.session.process_set import verb_command
from sphere_sim.scenario.scenarios import PAPER_CASES

pytestmark = pytest.mark.slow

CASE = PAPER_CASES[1]


def test_last_command_is_a_ramp_to_rest_after_ctrl_c_also_twice(graph) -> None:
    trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
    commands = graph.collect(Float64MultiArray, "rotor_commands")
    with started("controller", use_sim_time=True, strategy="paper") as controller:
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
        for _ in range(2):
            controller.send(signal.SIGINT)
            graph.spin_for(0.02)
        graph.until(lambda: controller.code is not None)
        graph.until(lambda: not np.any(commands[-1].data))
    sent = map(serialize_message, trajectories[-2:])
    before, last = (hold_and_stamp(message, 0)[0] for message in sent)
    assert not last.speeds[-1].any()
    assert last.end - last.start <= 0.25 + 1e-6, "100 rad/s at 400 rad/s^2"
    np.testing.assert_allclose(last.speeds[0], before.at(last.start), atol=1e-6)
    slowest = [command.data for command in commands if np.any(command.data)][-1]
    assert np.max(np.abs(slowest)) <= 400.0 * 0.01 + 1e-6, "the sampled ramp goes down to rest"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["-p", "horizon:=0"], "horizon: given 0, expected 1 to 60"),
        (["--params-file", "absent.yaml"], "cannot start: .* Error opening YAML file"),
    ],
)
def test_wrong_parameter_ends_the_node_with_one_line(arguments, words) -> None:
    node = subprocess.run(verb_command("controller", "--ros-args", *arguments),
                          stderr=subprocess.PIPE, text=True, timeout=PATIENCE)
    assert node.returncode == 2
    (line,) = node.stderr.splitlines()
    assert re.search(words, line)


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
    assert without_ros_arguments(["--port", "80", "--ros-args", "-p", "a:=b"]) == ["--port", "80"]
    with pytest.raises(RosArgumentsError) as caught:
        without_ros_arguments(words.split())
    assert told in str(caught.value)


SCHEDULING = """
import os, threading
from sphere_nmpc.ros.lifetime import schedule
threading.Thread(target=threading.Event().wait, daemon=True).start()
policies = lambda: {os.sched_getscheduler(int(task)) for task in os.listdir("/proc/self/task")}
usual = os.sched_getscheduler(0)
allowed = schedule(7)
assert policies() == {os.SCHED_FIFO if allowed else usual}, policies()
schedule(0)
assert policies() == {os.SCHED_OTHER if allowed else usual}, policies()
"""


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="policies are Linux' own")
def test_priority_is_that_of_all_threads_or_of_none() -> None:
    subprocess.run([sys.executable, "-c", SCHEDULING], check=True)


FOREIGN = """
import sys, threading, time
from sphere_nmpc.settings import STRATEGIES, StrategyEntry
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy

class Foreign(TimeOptimalStrategy):
    def __init__(self, *given):
        super().__init__(*given)
        if "thread" in sys.argv:
            threading.Thread(target=time.sleep, args=(3600.0,), name="own").start()

    def plan(self, situation):
        if "thread" in sys.argv or abs(situation.speeds).max() < 5.0:
            return super().plan(situation)
        while True:
            print("planning", flush=True)
            try:
                time.sleep(3600.0) if "sleep" in sys.argv else sum(range(1000))
            except BaseException:
                if "swallow" not in sys.argv:
                    raise

STRATEGIES["foreign"] = StrategyEntry("__main__:Foreign")
from sphere_nmpc.ros.controller.node import main
sys.exit(main(["--ros-args", "-p", "strategy:=foreign"]))
"""
"""Controller node with a strategy of another package, which does not return while rotors turn."""


def duration_of(trajectory: JointTrajectory) -> float:
    """Return how long a command takes [s]: one to rest a fraction of a second, others 3 s."""
    hold, _ = hold_and_stamp(serialize_message(trajectory), 0)
    return hold.end - hold.start


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("way", "code", "words"),
    [
        (["sleep"], 0, "solve failed: ForeignCodeError: Interruption"),
        (["busy"], 0, "solve failed: ForeignCodeError: Interruption"),
        (["sleep", "swallow"], 1, "code of another package does not return, and is left behind"),
        (["thread"], 0, "thread 'own' of another package is left behind"),
    ],
    ids=["sleeps", "computes", "swallows", "thread"],
)
def test_node_with_a_strategy_that_does_not_return_ends_by_a_signal(
    graph, tmp_path, way, code, words, number
) -> None:
    trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
    commands = graph.collect(Float64MultiArray, "rotor_commands")
    node = Child(python_command(FOREIGN, *way), log=tmp_path / "log").start()
    try:
        goals = graph.publisher(PoseStamped, "goal_pose")
        poses = graph.publisher(PoseStamped, "pose")

        def is_planning() -> bool:
            poses.publish(pose_to_ros(CASE.start, time.time_ns(), 0.3))
            goals.publish(pose_to_ros(CASE.goal, 0, 0.3))
            # From rest there is nothing to be stopped.
            turns = bool(commands) and max(map(abs, commands[-1].data)) > 5.0
            return trajectories and (turns if way == ["thread"] else "planning" in node.output)

        graph.until(is_planning)
        node.send(number)
        graph.until(lambda: node.code is not None)
        assert node.code == code, node.output
        graph.until(lambda: duration_of(trajectories[-1]) < 1.0)
    finally:
        node.kill()
    assert words in node.output and "Traceback" not in node.output
