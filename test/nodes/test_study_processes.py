# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Processes of a study: equal results wherever runs are made, and what is kept when it ends."""

import csv
import json
import math
import os
import resource
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from children import wait_for_end
from distributed import LocalCluster
from patience import PATIENCE, until

from sphere_nmpc.process.child import Child
from sphere_sim.ros.session.process_set import verb_command
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


def study(folder: Path, *arguments: str, **options: object) -> Child:
    """Start a study, whose output is in ``study.log``."""
    command, log = verb_command("study", *arguments), folder / "study.log"
    return Child(command, "study", log, **options).start()


def stopped(process: Child, ready: Callable[[], bool], number: int, all_of_them: bool) -> str:
    """Send a signal when `ready`; return the output when all processes have ended."""
    try:
        until(lambda: ready() or not process.running, 0.05)
        children = psutil.Process(process.pid).children(recursive=True)
        (os.killpg if all_of_them else os.kill)(process.pid, number)
        process.wait(PATIENCE)
    finally:
        process.kill()
    assert children
    wait_for_end(child.pid for child in children)
    return process.output


def lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def test_killed_study_keeps_its_runs(tmp_path) -> None:
    runs, journal = 500, tmp_path / "journal.jsonl"
    process = study(tmp_path, "--draw", str(runs), "--seed", "2", "--out", str(tmp_path),
                    "--jobs", "2", "--no-bound")
    message = stopped(process, lambda: lines(journal) > 2, signal.SIGTERM, False)
    assert process.code == 143
    assert "interrupted" in message and "Traceback" not in message
    assert 2 < lines(journal) < runs


def test_interrupted_search_for_best_known_times_leaves_all_other_results(tmp_path) -> None:
    out = tmp_path / "out"
    process = study(
        tmp_path, "--draw", "20", "--kind", "half_turn", "--duration", "0.5", "--out", str(out),
        "--jobs", "2", "--strategy", "paper",
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
    )
    kept = tmp_path / "sphere_nmpc" / "best_known_times.jsonl"
    message = stopped(process, lambda: lines(kept) > 0, signal.SIGINT, True)
    assert process.code == 130
    assert "all results but the best known times" in message and "Traceback" not in message
    with (out / "runs.csv").open(encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == 20
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["runs"] == 20
    assert (out / "inputs.npz").exists()


def test_study_on_a_full_disk_keeps_its_runs_and_continues(tmp_path) -> None:
    journal = tmp_path / "journal.jsonl"
    runs = [
        "--draw", "4", "--duration", "0.5", "--jobs", "1", "--strategy", "paper", "--no-bound"
    ]

    def run(most: int) -> tuple[int, list[str]]:
        done = subprocess.run(
            verb_command("study", *runs, "--out", str(tmp_path)), timeout=PATIENCE, text=True,
            capture_output=True,  # the limit would be that of a log, too
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
            # Bytecode that the limit truncates would break each later import.
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        )
        assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
        told = [line for line in done.stderr.splitlines() if "study:" in line]
        return done.returncode, told

    def cannot(name: str) -> list[str]:
        reason = "cannot be written: file too large; the same command continues from the runs made"
        return [f"sphere_nmpc study: {tmp_path / name}: {reason}"]

    assert run(100) == (1, cannot("journal.jsonl"))
    assert run(10**4)[0] == 0 and lines(journal) == 5
    before = (tmp_path / "runs.csv").read_bytes()
    assert run(100) == (1, cannot("runs.csv"))
    assert (tmp_path / "runs.csv").read_bytes() == before
