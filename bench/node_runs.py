# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller as processes over DDS, and an observer that needs little time itself.

Times of messages are those of their publication, as the middleware reports them, so that a late
observer measures the same.
"""

import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.quantities import NANOSECONDS
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.goal_run import GoalRunner
from sphere_sim.ros.session.process_set import ProcessSet, parameter_options
from sphere_sim.ros.session.serving import serve_until

PATIENCE = 600.0
"""How long nodes on a busy machine may take to be ready [s]."""
_SPIN = 0.01
"""Wall time between two looks at what was received [s]."""
_PRIORITY: dict[str, object] = {"thread_priority": 1}
"""Parameters of the measured nodes, where the system allows it."""


@dataclass
class Record:
    """Published messages: stamps [s, control time] and times of publication [s, wall time]."""

    newest_pose: bytes = b""
    pose_stamps: list[float] = field(default_factory=list)
    pose_written: list[float] = field(default_factory=list)
    command_stamps: list[float] = field(default_factory=list)
    command_written: list[float] = field(default_factory=list)
    statuses: list[dict[str, str]] = field(default_factory=list)


class Observer:
    """Node that sends goals, starts time and records what is published."""

    def __init__(self, processes: ProcessSet) -> None:
        self.processes = processes
        self.record = Record()
        self._node = rclpy.create_node("observer")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.goals = GoalRunner(self._node, self.spin)
        self._pause = self._node.create_client(SetBool, "simulator/pause")
        # These are read without the executor, which takes longer for a message than the nodes do,
        # and so belong to a node of their own. rclpy has no other call that returns the time of
        # publication: its events executor cannot serve callbacks that take it.
        self._reader = rclpy.create_node("reader")
        self._frequent: list[tuple[Any, Callable[[bytes, float], None]]] = [
            (self._reader.create_subscription(kind, topic, _ignore, 1000, raw=True), take)
            for kind, topic, take in (
                (PoseStamped, "pose", self._take_pose),
                (JointTrajectory, "rotor_trajectory", self._take_command),
                (DiagnosticStatus, "controller/status", self._take_status),
            )
        ]

    def begin(self) -> None:
        """Wait for both nodes and start time."""
        self.goals.prepare(PATIENCE)
        self._require(self._pause.service_is_ready, "the simulator's services")
        self._require(
            lambda: self._node.count_subscribers("rotor_trajectory") > 1, "the simulator's input"
        )
        future = self._pause.call_async(SetBool.Request(data=False))
        self._require(future.done, "the start of time")
        # Before the controller has a time, its status has no counters.
        self._require(lambda: "missed_ticks" in (self.record.statuses or [{}])[-1], "a status")

    def processor_time(self) -> dict[str, float]:
        """Return the processor time of each node with its child processes so far [s]."""
        return {name: _processor_time(pid) for name, pid in self.processes.pids.items()}

    def until(self, condition: Callable[[], Any], patience: float) -> bool:
        """Serve the node until `condition` holds; return False after `patience` [s, wall]."""
        return serve_until(self.spin, condition, patience)

    def spin(self) -> None:
        """Serve the node after a moment, and check that all processes run."""
        time.sleep(_SPIN)
        for _ in range(3):
            self._executor.spin_once(timeout_sec=0.0)
        for subscription, take in self._frequent:
            handle, kind = subscription.handle, subscription.msg_type
            with handle:
                while (taken := handle.take_message(kind, True)) is not None:
                    take(taken[0], taken[1]["source_timestamp"] / NANOSECONDS)
        self.processes.check()

    def _require(self, condition: Callable[[], Any], what: str) -> None:
        if not self.until(condition, PATIENCE):
            raise RuntimeError(f"timed out after {PATIENCE:g} s while waiting for {what}")

    def _take_pose(self, raw: bytes, written: float) -> None:
        self.record.newest_pose = raw
        self.record.pose_stamps.append(_stamp(raw))
        self.record.pose_written.append(written)

    def _take_command(self, raw: bytes, written: float) -> None:
        self.record.command_stamps.append(_stamp(raw))
        self.record.command_written.append(written)

    def _take_status(self, raw: bytes, _: float) -> None:
        message = deserialize_message(raw, DiagnosticStatus)
        self.record.statuses.append({value.key: value.value for value in message.values})


@contextmanager
def running(
    simulator: dict[str, object], controller: dict[str, object]
) -> Iterator[Observer]:
    """Run both nodes in a domain of their own; yield their observer, with time paused."""
    simulated = simulator.get("clock") != "system"
    parameters: dict[str, dict[str, object]] = {
        "simulator": {"start_paused": simulated, **simulator},
        "controller": {"use_sim_time": simulated, **controller},
    }
    with own_domain(), tempfile.TemporaryDirectory() as logs, ProcessSet(Path(logs)) as nodes:
        for verb, own in parameters.items():
            nodes.start(verb, ["--ros-args", *parameter_options(_PRIORITY | own)])
        rclpy.init(args=[])
        try:
            yield Observer(nodes)
        finally:
            rclpy.try_shutdown()


@contextmanager
def hogs(number: int) -> Iterator[None]:
    """Keep `number` processors busy with other processes."""
    code = "while True: pass"
    busy = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(number)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _ignore(_: bytes) -> None:
    """Stand for the callback of a subscription that is read without an executor."""


def _processor_time(pid: int) -> float:
    process = psutil.Process(pid)
    times = [part.cpu_times() for part in (process, *process.children(recursive=True))]
    return float(sum(time.user + time.system for time in times))


def _stamp(raw: bytes) -> float:
    """Return the stamp of a message that begins with a header [s], from its serialised form."""
    seconds, nanoseconds = struct.unpack_from("<iI", raw, 4)
    return float(seconds + nanoseconds * 1e-9)
