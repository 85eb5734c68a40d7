# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A worker process does tasks in order, is replaced when it fails, and ends with its owner."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from operator import contains, methodcaller
from select import select

import pytest
from patience import PATIENCE, until

from sphere_nmpc.worker import process
from sphere_nmpc.worker.contract import Reply
from sphere_nmpc.worker.process import WorkerProcess

pytestmark = pytest.mark.slow

interrupt = partial(signal.default_int_handler, signal.SIGINT)
"""Task that raises a KeyboardInterrupt."""
keep = partial(methodcaller, "setdefault")
"""Task that keeps a value by a name in the store, and returns the one that is kept."""


class Worker(WorkerProcess):
    """Worker process, with the faults that it has reported."""

    def __init__(self) -> None:
        self.faults: list[str] = []
        super().__init__(self.faults.append)

    def ended(self, reply: Reply[object]) -> Reply[object]:
        until(lambda: bool(self.poll() or not reply.pending), 2e-3)
        return reply

    def complete(self, reply: Reply[object]) -> object:
        assert not self.ended(reply).error
        return reply.result


@pytest.fixture
def worker(monkeypatch) -> Iterator[Worker]:
    monkeypatch.setattr(process, "_RESTART_EVERY", 0.0)
    made = Worker()
    yield made
    made.close()
    assert not made.available and made.submit(len).error


def test_tasks_are_done_in_order_and_share_a_store(worker) -> None:
    replies = [worker.submit(keep("first", value)) for value in (3, 4)]
    assert all(reply.pending for reply in replies), "submitting does not wait"
    assert [worker.complete(reply) for reply in replies] == [3, 3]


def test_task_that_raises_is_told_and_the_next_one_is_done(worker) -> None:
    failing, next_one = worker.submit(methodcaller("absent")), worker.submit(len)
    assert worker.complete(next_one) == 0
    assert "absent" in failing.error and not failing.ready
    assert worker.faults == [failing.error]


def test_task_that_would_end_the_process_is_told_and_the_process_goes_on(worker) -> None:
    pid = worker.pid
    ending, interrupting = worker.submit(sys.exit), worker.submit(interrupt)
    assert worker.complete(worker.submit(len)) == 0
    assert "SystemExit" in ending.error and "KeyboardInterrupt" in interrupting.error
    assert worker.pid == pid and worker.faults == [ending.error, interrupting.error]


class Made:
    """Object that a call makes when it is read."""

    def __init__(self, function: Callable[..., object], argument: str) -> None:
        self._call = function, (argument,)

    def __reduce__(self) -> tuple[object, ...]:
        return self._call


UNREADABLE = "type('', (), {'__reduce__': lambda _: (open, ('/nonexistent',))})()"
"""Object that can be sent, but reading it opens a file that is missing."""


def test_what_cannot_be_read_fails_alone_and_ends_no_process(worker) -> None:
    assert worker.complete(worker.submit(keep("kept", 1))) == 1
    task = worker.submit(keep("lost", Made(open, "/nonexistent")))
    assert "nonexistent" in worker.ended(task).error
    result = worker.submit(keep("lost", Made(eval, UNREADABLE)))
    assert "cannot be read" in worker.ended(result).error and "nonexistent" in result.error
    assert worker.complete(worker.submit(keep("kept", 2))) == 1
    assert worker.faults == [task.error, result.error]


def test_process_that_is_killed_fails_its_tasks_and_is_replaced(worker) -> None:
    assert worker.complete(worker.submit(keep("kept", 1))) == 1
    first = worker.pid
    os.kill(first, signal.SIGSTOP)
    reply = worker.submit(len)
    os.kill(first, signal.SIGKILL)
    assert worker.ended(reply).error and "replaced" in worker.faults[0]
    assert worker.complete(worker.submit(len)) == 0, "the store of the new process is empty"
    assert worker.pid != first


def test_process_with_an_endless_task_is_replaced(worker, monkeypatch) -> None:
    monkeypatch.setattr(process, "_RESULT_TIMEOUT", 0.2)
    assert worker.complete(worker.submit(len)) == 0
    reply = worker.submit(partial(contains, range(10**12)))
    assert "no result" in worker.ended(reply).error and "replaced" in worker.faults[0]
    assert worker.complete(worker.submit(len)) == 0


def test_process_that_waits_for_a_processor_is_kept(worker, monkeypatch) -> None:
    monkeypatch.setattr(process, "_RESULT_TIMEOUT", 1.0)
    assert worker.complete(worker.submit(len)) == 0
    # One processor for both; the worker has some thousandths of it.
    processor = {min(os.sched_getaffinity(0))}
    os.sched_setaffinity(worker.pid, processor)
    os.sched_setscheduler(worker.pid, os.SCHED_IDLE, os.sched_param(0))
    endless = "print(flush=True)\nwhile True: pass"
    other = subprocess.Popen([sys.executable, "-c", endless], stdout=subprocess.PIPE)
    os.sched_setaffinity(other.pid, processor)
    try:
        assert other.stdout is not None and other.stdout.readline()
        # Some 30 ms of work.
        reply = worker.submit(partial(contains, range(1_000_000)))
        began = time.monotonic()
        while reply.pending and time.monotonic() - began < 2.0:
            worker.poll()
            time.sleep(2e-3)
    finally:
        other.kill()
        other.wait()
    assert worker.complete(reply) is False
    assert worker.faults == []


def test_submitting_to_a_stopped_process_refuses_and_never_blocks(worker) -> None:
    assert worker.complete(worker.submit(len)) == 0
    os.kill(worker.pid, signal.SIGSTOP)
    # As much as the largest task: a transition with all the holds of a second.
    task = keep("large", bytes(16_000))
    replies = [worker.submit(task) for _ in range(12)]
    assert [reply.pending for reply in replies] == [True] * 8 + [False] * 4
    assert "busy" in replies[-1].error
    os.kill(worker.pid, signal.SIGCONT)
    assert worker.complete(replies[7]) == bytes(16_000)


def test_poll_does_not_wait_for_the_rest_of_a_result(worker) -> None:
    # Ten million characters: more than the pipe holds, so that a part of them has arrived.
    reply = worker.submit(partial("{:>10000000}".format, "end"))
    assert select([worker._child.channel], [], [], PATIENCE)[0], "timed out"
    os.kill(worker.pid, signal.SIGSTOP)
    polling = threading.Thread(target=worker.poll, daemon=True)
    polling.start()
    polling.join(PATIENCE)
    assert not polling.is_alive() and reply.pending
    os.kill(worker.pid, signal.SIGCONT)
    result = worker.complete(reply)
    assert isinstance(result, str) and len(result) == 10_000_000
    assert worker.complete(worker.submit(len)) == 0


def test_where_no_process_can_be_started_tasks_are_refused(monkeypatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nonexistent/python")
    worker = Worker()
    assert not worker.available and worker.submit(len).error
    assert "not started" in worker.faults[0]
