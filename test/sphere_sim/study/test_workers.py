# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Results do not depend on where the runs are made."""

import os
import socket
import threading
from contextlib import suppress

import pytest
from distributed import LocalCluster

from sphere_sim.cli.main import main
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study import cluster as cluster_module
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.errors import WorkersError
from sphere_sim.study.processes import Processes
from sphere_sim.study.record import RunRecord
from sphere_sim.study.single_run import run_scenario
from sphere_sim.study.workers import Workers, cores

SCENARIOS = draw_scenarios(6, 3)
CONDITIONS = StudyConditions(duration=3.0, perturbation=3.0, latency=0.02).with_settings(
    [("process_noise", "1e-3"), ("position_noise", "1e-3"), ("orientation_noise", "1e-3")]
)
TASKS = [(i, (CONDITIONS, scenario)) for i, scenario in enumerate(SCENARIOS)]


def make(workers: Workers) -> dict[int, RunRecord]:
    with workers:
        made = dict(workers.run(run_scenario, TASKS, "run"))
    for record in made.values():
        for name in [name for name in record.results if name.startswith("solve_ms_")]:
            del record.results[name]
    return made


@pytest.fixture(scope="module")
def made_here() -> dict[int, RunRecord]:
    return make(Workers(1))


@pytest.fixture(scope="module")
def cluster():
    with LocalCluster(
        n_workers=2, threads_per_worker=2, dashboard_address=None, memory_limit=0
    ) as cluster:
        yield cluster


def test_all_cores_give_the_same_to_the_bit(made_here) -> None:
    assert make(Workers(max(2, cores()))) == made_here


def test_two_workers_of_a_cluster_give_the_same_to_the_bit(made_here, cluster) -> None:
    assert make(Workers(scheduler=cluster.scheduler_address)) == made_here


def test_study_on_a_cluster_searches_best_known_times_there_too(
    cluster, tmp_path, monkeypatch
) -> None:
    def run(*arguments: object) -> None:
        raise AssertionError("a call on this machine")

    monkeypatch.setattr(Processes, "run", run)
    monkeypatch.setattr(os, "environ", {**os.environ, "XDG_CACHE_HOME": str(tmp_path)})
    options = ["--draw", "2", "--duration", "0.5", "--strategy", "paper"]
    where = ["--scheduler", cluster.scheduler_address, "--out", str(tmp_path / "out")]
    assert main(["study", *options, *where]) == 0
    assert len((tmp_path / "sphere_nmpc" / "best_known_times.jsonl").read_text().splitlines()) == 2


def test_workers_with_other_code_are_refused(cluster, monkeypatch) -> None:
    monkeypatch.setattr(cluster_module, "_same_code", lambda digest: False)
    with pytest.raises(WorkersError, match="another version"):
        make(Workers(scheduler=cluster.scheduler_address))


def test_unreachable_scheduler_is_an_error(monkeypatch) -> None:
    monkeypatch.setattr(cluster_module, "_CONNECT_TIMEOUT", 0.5)
    with pytest.raises(WorkersError, match="cannot be reached"):
        make(Workers(scheduler="tcp://127.0.0.1:1"))


@pytest.mark.parametrize(
    ("answer", "words"),
    [(b"", r"no answer of a scheduler within 2.5 s"), (b"HTTP/1.1 400 Bad Request\r\n\r\n", "")],
)
def test_listener_that_is_no_scheduler_is_one_error_in_the_time_that_is_told(
    answer, words, monkeypatch, caplog
) -> None:
    def serve() -> None:
        with suppress(OSError):
            while True:
                connected.append(listener.accept()[0])
                connected[-1].sendall(answer)

    monkeypatch.setattr(cluster_module, "_CONNECT_TIMEOUT", 2.5)
    connected: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, daemon=True).start()
        address = "tcp://{}:{}".format(*listener.getsockname())
        with pytest.raises(WorkersError, match=rf"{address}: cannot be reached \(.*{words}"):
            make(Workers(scheduler=address))
        listener.shutdown(socket.SHUT_RDWR)
    assert bool(answer) != ("waiting for the scheduler" in caplog.text)


def test_worker_is_no_scheduler(cluster) -> None:
    address = next(iter(cluster.scheduler_info["workers"]))
    with pytest.raises(WorkersError, match="given Dask's 'Worker', expected a scheduler"):
        make(Workers(scheduler=address))


def test_cluster_that_ends_is_one_error() -> None:
    with LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, memory_limit=0,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    ) as closing, Workers(scheduler=closing.scheduler_address) as workers:
        runs = workers.run(run_scenario, TASKS, "run")
        next(runs)
        closing.close()
        with pytest.raises(WorkersError, match=r"run \d+ .*the scheduler is gone"):
            list(runs)


def test_no_run_needs_no_cluster() -> None:
    with Workers(scheduler="tcp://127.0.0.1:1") as workers:
        assert list(workers.run(run_scenario, [], "run")) == []
