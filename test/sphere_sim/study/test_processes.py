# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Processes that die or cannot be started, and the end of their parent."""

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from patience import PATIENCE

from sphere_sim.study.errors import WorkersError
from sphere_sim.study.processes import TRIES, Processes

LONG_CALLS = """
import threading, time
from sphere_sim.study.processes import Processes
if __name__ == "__main__":
    # This thread may take a signal, which is then handled in the main thread.
    threading.Thread(target=time.sleep, args=(3600,), daemon=True).start()
    with Processes(2) as processes:
        list(processes.run(time.sleep, [(i, (3600,)) for i in range(9)], "nap"))
"""

WITHOUT_DESCRIPTORS = """
import math, os
from sphere_sim.study.processes import Processes
if __name__ == "__main__":
    with Processes(2) as processes:
        try:
            while True:
                os.dup(0)
        except OSError:
            pass
        next(processes.run(math.sqrt, [(i, (4,)) for i in range(9)], "root"))
"""


def workers(parent: psutil.Process) -> list[psutil.Process]:
    """Return the worker processes that run; their second thread watches the parent."""
    return [
        child for child in parent.children()
        if "study.worker_process" in " ".join(child.cmdline()) and child.num_threads() == 2
    ]


@pytest.fixture
def starting(tmp_path):
    """Start a program that starts two processes, which are then busy for ten minutes."""
    (tmp_path / "naps.py").write_text(LONG_CALLS)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "naps.py")], start_new_session=True, text=True,
        stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    yield process
    process.kill()
    process.communicate()


@pytest.fixture
def napping(starting):
    while len(workers(psutil.Process(starting.pid))) < 2:
        assert starting.poll() is None, starting.stderr.read()
        time.sleep(0.05)
    return starting


def test_results_come_with_the_names_of_their_tasks() -> None:
    tasks = [(i, (i,)) for i in range(20)]
    with Processes(2) as processes:
        assert dict(processes.run(math.sqrt, tasks, "root")) == {i: i**0.5 for i in range(20)}
        assert len(workers(psutil.Process())) == 2
    assert not workers(psutil.Process())


def test_call_whose_process_is_killed_is_made_again() -> None:
    tasks = [(0, (0.0,)), *((i, (1.0,)) for i in range(1, 5))]
    seen = []
    with Processes(2) as processes:
        for name, _ in processes.run(time.sleep, tasks, "nap"):
            if not seen:
                killed = workers(psutil.Process())
                for child in killed:
                    child.kill()
            seen.append(name)
    assert killed and sorted(seen) == [0, 1, 2, 3, 4]


def test_call_whose_process_dies_each_time_is_an_error() -> None:
    words = rf"run \d: its process died {TRIES} times \(exit code 7\)"
    with Processes(2) as processes, pytest.raises(WorkersError, match=words):
        list(processes.run(os._exit, [(i, (7,)) for i in range(3)], "run"))


def test_call_that_raises_is_named() -> None:
    with Processes(2) as processes, pytest.raises(WorkersError, match=r"run 1 .*ValueError: math"):
        list(processes.run(math.sqrt, [(0, (1.0,)), (1, (-1.0,))], "run"))


def test_process_that_cannot_be_started_is_one_error(tmp_path) -> None:
    (tmp_path / "full.py").write_text(WITHOUT_DESCRIPTORS)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "full.py")], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}, timeout=PATIENCE,
    )
    assert done.stderr.splitlines()[-1].endswith(
        "WorkersError: no process can be started (Too many open files); --jobs 1 needs none"
    )


def test_interrupt_ends_all_processes_and_only_the_parent_reports(napping) -> None:
    children = workers(psutil.Process(napping.pid))
    os.killpg(napping.pid, signal.SIGINT)
    _, message = napping.communicate(timeout=PATIENCE)  # of the hour that the calls take
    assert message.count("Traceback") == 1 and message.endswith("KeyboardInterrupt\n")
    assert not any(child.is_running() for child in children)


@pytest.mark.parametrize("attempt", range(5))
def test_interrupt_while_processes_start_is_one_traceback(starting, attempt) -> None:
    children = Path(f"/proc/{starting.pid}/task/{starting.pid}/children")
    while not children.read_text():
        assert starting.poll() is None
    os.killpg(starting.pid, signal.SIGINT)
    _, message = starting.communicate(timeout=PATIENCE)
    assert message.count("Traceback") == 1 and message.endswith("KeyboardInterrupt\n")


def test_no_process_outlives_a_killed_parent(napping) -> None:
    children = workers(psutil.Process(napping.pid))
    napping.kill()
    _, alive = psutil.wait_procs(children, timeout=PATIENCE)
    assert not alive
