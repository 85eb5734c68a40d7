# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The verb ``study`` stopped by a signal or a full disk: runs are kept, and it continues."""

import csv
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
from patience import PATIENCE

pytestmark = pytest.mark.slow

COMMAND = [sys.executable, "-c", "from sphere_sim.cli.main import main; exit(main())", "study"]


def start(*arguments: str, **options: object) -> subprocess.Popen:
    return subprocess.Popen(
        [*COMMAND, *arguments], start_new_session=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options,
    )


def stop(
    process: subprocess.Popen, ready: Callable[[], bool], number: int, all_of_them: bool
) -> str:
    """Send a signal when `ready`; return standard error when all processes have ended."""
    try:
        while not ready():
            assert process.poll() is None, process.communicate()
            time.sleep(0.05)
        children = psutil.Process(process.pid).children(recursive=True)
        (os.killpg if all_of_them else os.kill)(process.pid, number)
        _, message = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    _, alive = psutil.wait_procs(children, timeout=PATIENCE)
    assert children and not alive
    return message


def lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def test_killed_study_keeps_its_runs(tmp_path) -> None:
    runs, journal = 500, tmp_path / "journal.jsonl"
    process = start(
        "--draw", str(runs), "--seed", "2", "--out", str(tmp_path), "--jobs", "2", "--no-bound"
    )
    message = stop(process, lambda: lines(journal) > 2, signal.SIGTERM, False)
    assert process.returncode == 143
    assert "interrupted" in message and "Traceback" not in message
    assert 2 < lines(journal) < runs


def test_interrupted_search_for_best_known_times_leaves_all_other_results(tmp_path) -> None:
    out = tmp_path / "out"
    process = start(
        "--draw", "20", "--kind", "half_turn", "--duration", "0.5", "--out", str(out),
        "--jobs", "2", "--strategy", "paper",
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
    )
    kept = tmp_path / "sphere_nmpc" / "best_known_times.jsonl"
    message = stop(process, lambda: lines(kept) > 0, signal.SIGINT, True)
    assert process.returncode == 130
    assert "all results but the best known times" in message and "Traceback" not in message
    with (out / "runs.csv").open(encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == 20
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["runs"] == 20
    assert (out / "inputs.npz").exists()


def test_study_on_a_full_disk_keeps_its_runs_and_continues(tmp_path) -> None:
    """A limit on the size of files makes a write fail as a full disk does."""
    journal = tmp_path / "journal.jsonl"
    study = [
        "--draw", "4", "--duration", "0.5", "--jobs", "1", "--strategy", "paper", "--no-bound"
    ]

    def run(most: int) -> tuple[int, list[str]]:
        process = start(
            *study, "--out", str(tmp_path),
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
            # Bytecode that the limit truncates would break each later import.
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        )
        _, message = process.communicate(timeout=PATIENCE)
        assert "Traceback" not in message and "Exception ignored" not in message
        return process.returncode, [line for line in message.splitlines() if "study:" in line]

    def cannot(name: str) -> list[str]:
        reason = "cannot be written: file too large; the same command continues from the runs made"
        return [f"sphere_nmpc study: {tmp_path / name}: {reason}"]

    assert run(100) == (1, cannot("journal.jsonl"))
    assert run(10**4)[0] == 0 and lines(journal) == 5
    before = (tmp_path / "runs.csv").read_bytes()
    assert run(100) == (1, cannot("runs.csv"))
    assert (tmp_path / "runs.csv").read_bytes() == before
