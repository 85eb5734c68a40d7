# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Processes on trial are killed, held and ended, and what they said is kept."""

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from sphere_sim.ros.session.processes import NodeProcess, stop_together

PATIENCE = 20.0
"""How long a busy machine may take to start a process [s]."""


@pytest.fixture
def process(tmp_path, monkeypatch) -> Iterator[NodeProcess]:
    """A process that says when it is up, and then waits."""
    (tmp_path / "waiting.py").write_text(
        "import signal, sys, time\n"
        "signal.signal(signal.SIGINT, lambda *_: sys.exit(7))\n"
        "print('up', *sys.argv[1:], flush=True)\n"
        "if 'fail' in sys.argv: raise ValueError('as asked')\n"
        "time.sleep(60)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    process = NodeProcess("waiting", ["waiting"], tmp_path)
    yield process
    process.kill()


def start(process: NodeProcess, *extra: str) -> None:
    before = lines(process.log)
    process.start(extra)
    end = time.monotonic() + PATIENCE
    while lines(process.log) == before:
        assert time.monotonic() < end
        time.sleep(0.02)


def lines(log: Path) -> int:
    return log.read_text().count("up") if log.exists() else 0


def test_killed_process_says_how_it_ended_and_lives_again(process) -> None:
    start(process)
    assert process.code is None
    assert "SIGKILL" in process.kill()
    start(process, "again")
    assert process.code is None
    assert process.log.read_text().split() == ["up", "up", "again"]


def test_process_that_is_started_twice_is_one(process) -> None:
    start(process)
    first = process.pid
    start(process)
    assert process.pid != first and not psutil.pid_exists(first)


def test_process_is_ended_politely_even_where_it_is_held(process) -> None:
    start(process)
    process.send(signal.SIGSTOP)
    process.stop()
    assert process.code == 7


def test_several_are_ended_together(process) -> None:
    start(process)
    stop_together([process, NodeProcess("never", ["never"], process.log.parent)])
    assert process.code == 7


def test_errors_that_nobody_caught_are_counted(process) -> None:
    start(process, "fail")
    assert "exit code 1" in process.wait(PATIENCE)
    assert process.tracebacks() == 1
