# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Results do not depend on where calls are made; processes die, cannot be started, or end."""

import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from distributed import LocalCluster
from patience import PATIENCE

from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study import workers as workers_module
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
from sphere_sim.study.workers import TRIES, Workers, WorkersError

pytestmark = pytest.mark.slow

CONDITIONS = StudyConditions(duration=1.0, perturbation=3.0, latency=0.02).with_settings(
    [("process_noise", "1e-3"), ("position_noise", "1e-3"), ("planning_effort", "20000")]
)
TASKS = [(i, (CONDITIONS, scenario)) for i, scenario in enumerate(draw_scenarios(4, 3))]
LONG_CALLS = """
import threading, time
from sphere_sim.study.workers import Workers
if __name__ == "__main__":
    # This thread may take a signal, which is then handled in the main thread.
    threading.Thread(target=time.sleep, args=(3600,), daemon=True).start()
    with Workers(2) as workers:
        list(workers.run(time.sleep, [(i, (3600,)) for i in range(9)], "nap"))
"""
def make(workers: Workers) -> dict[int, str]:
    """Return the record of each run of `TASKS`, without what depends on the machine."""
    with workers:
        made = dict(workers.run(run_scenario, TASKS, "run"))
    for record in made.values():
        for name in [name for name in record.results if name.startswith("solve_ms_")]:
            del record.results[name]
    return {index: record.as_json(index) for index, record in made.items()}


def processes(parent: psutil.Process) -> list[psutil.Process]:
    return [c for c in parent.children() if "study.workers" in " ".join(c.cmdline())]


@pytest.fixture(scope="module")
def made_here() -> dict[int, str]:
    return make(Workers(1))


@pytest.fixture(scope="module")
def cluster():
    with LocalCluster(
        n_workers=2, threads_per_worker=2, dashboard_address=None, memory_limit=0
    ) as cluster:
        yield cluster


@pytest.fixture
def napping(tmp_path):
    """Start a program whose two processes are then busy for an hour."""
    program = tmp_path / "naps.py"
    program.write_text(LONG_CALLS)
    process = subprocess.Popen(
        [sys.executable, program], start_new_session=True, text=True, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    while len(processes(psutil.Process(process.pid))) < 2:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)
    yield process
    process.kill()
    process.communicate()


def test_two_processes_give_the_same_to_the_bit_and_end(made_here) -> None:
    assert make(Workers(2)) == made_here
    assert not processes(psutil.Process())


def test_call_whose_process_is_killed_is_made_again() -> None:
    tasks = [(0, (0.0,)), *((i, (1.0,)) for i in range(1, 5))]
    seen, killed = [], []
    with Workers(2) as workers:
        for name, _ in workers.run(time.sleep, tasks, "nap"):
            if not seen:
                killed = processes(psutil.Process())
                for child in killed:
                    child.kill()
            seen.append(name)
    assert killed and sorted(seen) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("call", "arguments", "words"),
    [
        (os._exit, (7,), rf"run \d: its process died {TRIES} times \(.*exit code 7\)"),
        (math.sqrt, (-1.0,), r"run \d could not be made: ValueError: math"),
    ],
)
def test_call_that_cannot_be_made_is_one_error(call, arguments, words) -> None:
    with Workers(2) as workers, pytest.raises(WorkersError, match=words):
        list(workers.run(call, [(i, arguments) for i in range(3)], "run"))


def test_interrupt_ends_all_processes_and_only_the_parent_reports(napping) -> None:
    children = processes(psutil.Process(napping.pid))
    os.killpg(napping.pid, signal.SIGINT)
    _, message = napping.communicate(timeout=PATIENCE)  # of the hour that the calls take
    assert message.count("Traceback") == 1 and message.endswith("KeyboardInterrupt\n")
    _, alive = psutil.wait_procs(children, timeout=PATIENCE)
    assert not alive


def test_no_process_outlives_a_killed_parent(napping) -> None:
    children = processes(psutil.Process(napping.pid))
    napping.kill()
    _, alive = psutil.wait_procs(children, timeout=PATIENCE)
    assert not alive


def test_two_workers_of_a_cluster_give_the_same_to_the_bit(made_here, cluster) -> None:
    assert make(Workers(scheduler=cluster.scheduler_address)) == made_here


def test_workers_with_other_code_are_refused(cluster, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.study.journal.code_digest", lambda: "1")
    with pytest.raises(WorkersError, match="another version"), Workers(
        scheduler=cluster.scheduler_address
    ) as workers:
        monkeypatch.setattr(
            "distributed.Client.run", lambda self, function: {"tcp://worker": "2"}
        )
        list(workers.run(run_scenario, TASKS, "run"))


def test_address_without_a_scheduler_is_one_error(monkeypatch) -> None:
    def serve() -> None:
        with suppress(OSError):
            while True:
                connected.append(listener.accept()[0])
                connected[-1].sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

    monkeypatch.setattr(workers_module, "_CONNECT_TIMEOUT", 2.5)
    connected: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, daemon=True).start()
        address = "tcp://{}:{}".format(*listener.getsockname())
        with pytest.raises(WorkersError, match=rf"{address}: cannot be reached \("):
            make(Workers(scheduler=address))
        listener.shutdown(socket.SHUT_RDWR)
