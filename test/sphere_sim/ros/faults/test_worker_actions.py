# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The worker of a process is found and signalled, and nothing else is."""

import os
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from patience import PATIENCE

from sphere_nmpc.worker.process import WorkerProcess
from sphere_sim.ros.faults.worker_actions import SignalWorker, worker_of
from sphere_sim.ros.session.serving import serve_until


@pytest.fixture
def worker():
    process = WorkerProcess(lambda line: None)
    yield process
    process.close()


def session() -> SimpleNamespace:
    """Return a session whose controller is this process."""

    def wait(condition, timeout, what) -> None:
        assert serve_until(lambda: time.sleep(0.01), condition, timeout), what

    return SimpleNamespace(processes={"controller": SimpleNamespace(pid=os.getpid())}, wait=wait)


def is_in_state(pid: int, state: str) -> bool:
    """Return whether a process is in a state, T for a stopped one."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == state


def test_only_the_worker_of_the_controller_is_found(worker) -> None:
    assert serve_until(lambda: time.sleep(0.01), lambda: worker_of(os.getpid()), PATIENCE)
    assert worker_of(os.getpid()) == worker.pid
    assert worker_of(worker.pid) == 0


def test_stopped_worker_continues_at_the_end(worker) -> None:
    action = SignalWorker("SIGSTOP")
    action.begin(session())
    assert serve_until(lambda: time.sleep(0.01), lambda: is_in_state(worker.pid, "T"), PATIENCE)
    action.end(session())
    assert serve_until(
        lambda: time.sleep(0.01), lambda: not is_in_state(worker.pid, "T"), PATIENCE
    )


def test_killed_worker_is_not_there_any_more(worker) -> None:
    action = SignalWorker("SIGKILL")
    action.begin(session())
    assert serve_until(lambda: time.sleep(0.01), lambda: worker_of(os.getpid()) == 0, PATIENCE)
    action.end(session())
