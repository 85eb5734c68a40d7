# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Child processes never import what lies in the working directory, as a `random.py` by a bag."""

import os
import subprocess
import sys
from pathlib import Path

from patience import PATIENCE

from sphere_nmpc.child import module_command, python_command

NAMES = ("random", "numpy", "re", "os", "sys", "subprocess", "selectors", "sphere_nmpc")
ROOT = Path(__file__).parents[2]


def test_children_of_python_are_started_in_one_place_only() -> None:
    users = {
        path.relative_to(ROOT).as_posix() for tree in ("sphere_nmpc", "sphere_sim", "launch")
        for path in (ROOT / tree).rglob("*.py") if "sys.executable" in path.read_text("utf-8")
    }
    assert users == {"sphere_nmpc/child.py"}


def test_child_imports_what_its_parent_imports_or_from_its_own_path(tmp_path, monkeypatch) -> None:
    hostile, beside = tmp_path / "bags", tmp_path / "beside"
    hostile.mkdir()
    for name in NAMES:
        (hostile / f"{name}.py").write_text("raise SystemExit(9)")
    beside.mkdir()
    (beside / "answer.py").write_text("def main(words): return len(words)")
    monkeypatch.syspath_prepend(beside)

    def run(command: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, cwd=hostile, capture_output=True, text=True, check=False, timeout=PATIENCE,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )

    assert run(module_command("answer", "a", "b c")).returncode == 2
    # Without the package's command the modules of the folder would be imported.
    assert run([sys.executable, "-c", "import random"]).returncode == 9
    program = "import random; print(sys.argv[1:], sys.path)"
    other = run(python_command(program, "x", python=sys.executable))
    assert other.returncode == 0
    assert other.stdout.startswith("['x'] ['") and str(beside) not in other.stdout
