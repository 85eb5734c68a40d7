# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A fault that could not be begun completely is ended completely."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from sphere_sim.ros.faults.fault_session import SessionError
from sphere_sim.ros.faults.process_actions import SecondController
from sphere_sim.ros.session.process_set import ProcessSet


class Session:
    """A session in which nothing that is waited for happens."""

    def __init__(self, folder: Path) -> None:
        self.processes = ProcessSet(folder)
        waiting = [sys.executable, "-c", "import time; time.sleep(600)"]
        self.processes.add("controller", waiting)
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

    def wait(self, condition: object, timeout: float, what: str) -> None:
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
