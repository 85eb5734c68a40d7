# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Child processes never import what lies in the working directory, as a `random.py` by a bag."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE

from sphere_nmpc.child import module_command, python_command

NAMES = ("random", "numpy", "re", "os", "sys", "subprocess", "selectors", "sphere_nmpc")
ROOT = Path(__file__).parents[2]
WORKER = """
import time
from sphere_nmpc.worker.process import WorkerProcess
worker = WorkerProcess(print)
reply = worker.submit(len)
while reply.pending:
    worker.poll()
    time.sleep(0.01)
assert reply.ready, reply.error
"""


@pytest.fixture
def hostile_folder(tmp_path: Path) -> Path:
    """Return a folder with modules that end the process that imports them."""
    folder = tmp_path / "bags"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text("raise SystemExit(9)")
    return folder


def run_in(folder: Path, command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=PATIENCE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def test_children_of_python_are_started_in_one_place_only() -> None:
    users = {
        path.relative_to(ROOT).as_posix() for tree in ("sphere_nmpc", "sphere_sim", "launch")
        for path in (ROOT / tree).rglob("*.py") if "sys.executable" in path.read_text("utf-8")
    }
    assert len(users) == 1, users


def test_worker_of_a_controller_imports_nothing_from_the_working_directory(
    hostile_folder, tmp_path
) -> None:
    (tmp_path / "program.py").write_text(WORKER)
    done = run_in(hostile_folder, [sys.executable, str(tmp_path / "program.py")])
    assert done.returncode == 0, done.stderr


def test_child_imports_what_its_parent_imports(tmp_path, monkeypatch, hostile_folder) -> None:
    (tmp_path / "beside").mkdir()
    (tmp_path / "beside" / "answer.py").write_text("def main(words): return len(words)")
    monkeypatch.syspath_prepend(tmp_path / "beside")
    assert run_in(hostile_folder, module_command("answer", "a", "b c")).returncode == 2
    # Without the package's command the modules of the folder would be imported.
    assert run_in(hostile_folder, [sys.executable, "-c", "import random"]).returncode == 9


def test_another_python_imports_from_its_own_path(monkeypatch, hostile_folder, tmp_path) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    program = "import random; print(sys.argv[1:], sys.path)"
    done = run_in(hostile_folder, python_command(program, "x", python=sys.executable))
    assert done.returncode == 0
    assert done.stdout.startswith("['x'] ['") and str(tmp_path) not in done.stdout
