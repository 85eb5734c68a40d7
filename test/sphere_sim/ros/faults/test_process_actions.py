# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Actions on processes: a fault that could not be begun completely is ended completely."""

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from patience import PATIENCE

from sphere_sim.ros.faults.fault_session import SessionError
from sphere_sim.ros.faults.process_actions import DiskFull, Hogs, SecondController, Stop
from sphere_sim.ros.session.child_process import ChildProcess
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.ros.session.serving import serve_until


class Session:
    """A session in which nothing happens during a wait."""

    def __init__(self, folder: Path) -> None:
        self.processes = ProcessSet(folder)
        waiting = [sys.executable, "-c", "import time; time.sleep(600)"]
        for name in ("controller", "recorder"):
            self.processes.add(name, waiting)
        self.settings = SimpleNamespace(folder=folder)
        self.rng = np.random.default_rng(0)
        self.publishers: list[object] = []
        self.node = SimpleNamespace(
            create_publisher=self._create, destroy_publisher=self.publishers.remove
        )

    def _create(self, kind: type, topic: str, depth: int) -> object:
        self.publishers.append(SimpleNamespace(get_subscription_count=lambda: 0))
        return self.publishers[-1]

    def arguments(self, name: str) -> list[str]:
        return []

    def wait(self, condition: Callable[[], object], timeout: float, what: str) -> None:
        if not condition():
            raise SessionError(f"timed out while waiting for {what}")


def test_second_controller_that_does_not_connect_is_ended(tmp_path) -> None:
    session, action = Session(tmp_path), SecondController()
    with session.processes, pytest.raises(SessionError, match="the second controller"):
        try:
            action.begin(session)
        finally:
            rival = session.processes["rival"]
            action.end(session)
    assert not rival.running and rival.pid
    assert session.publishers == []


def state_of(process: ChildProcess) -> str:
    """Return the state of a process in the words of Linux, T for a stopped one."""
    return Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_stopped_process_continues_at_the_end(tmp_path) -> None:
    session, action = Session(tmp_path), Stop("controller")
    with session.processes:
        controller = session.processes["controller"]
        controller.start()
        action.begin(session)
        assert serve_until(lambda: time.sleep(0.01), lambda: state_of(controller) == "T", PATIENCE)
        action.end(session)
        assert serve_until(lambda: time.sleep(0.01), lambda: state_of(controller) != "T", PATIENCE)


def limit_of(process: ChildProcess) -> int:
    """Return the largest size of a file that a process may write [bytes]; -1 without a limit."""
    return resource.prlimit(process.pid, resource.RLIMIT_FSIZE)[0]


def test_full_disk_is_an_error_of_the_campaign_while_nothing_is_recorded(tmp_path) -> None:
    session, action = Session(tmp_path), DiskFull()
    with session.processes:
        session.processes["recorder"].start()
        with pytest.raises(SessionError, match="a bag"):
            action.begin(session)
        action.end(session)


def test_full_disk_limits_the_file_that_was_written_last(tmp_path) -> None:
    session, action = Session(tmp_path), DiskFull()
    for number, size in ((1, 5000), (2, 100)):
        bag = tmp_path / f"bag_{number}"
        bag.mkdir()
        (bag / "bag.mcap").write_bytes(bytes(size))
        os.utime(bag / "bag.mcap", (number, number))
    with session.processes:
        recorder = session.processes["recorder"]
        recorder.start()
        before = limit_of(recorder)
        action.begin(session)
        assert limit_of(recorder) == 1100
        action.end(session)
        assert limit_of(recorder) == before


def test_processes_that_fill_the_processor_end_if_one_does_not_start(monkeypatch) -> None:
    started: list[subprocess.Popen] = []
    start = subprocess.Popen

    def start_one(*arguments, **options) -> subprocess.Popen:
        if started:
            raise BlockingIOError("no more processes")
        started.append(start(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start_one)
    action = Hogs(2)
    with pytest.raises(BlockingIOError):
        action.begin(None)
    action.end(None)
    (hog,) = started
    assert hog.returncode is not None
