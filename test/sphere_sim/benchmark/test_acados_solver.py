# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The interface to acados in another Python: reasons where it is missing, answers, times."""

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rich")

from sphere_sim.benchmark.acados_solver import Acados, acados_makers
from sphere_sim.benchmark.closed_loops import run_closed_loops, set_up
from sphere_sim.benchmark.problem import LIMIT, Answer
from sphere_sim.scenario.scenarios import PAPER_CASES


def script(folder: Path, text: str) -> str:
    """Return a stand-in for the other Python, which runs `text` with this one."""
    path = folder / "python"
    path.write_text(f"#!{sys.executable}\n{text}\n")
    path.chmod(0o755)
    return str(path)


def test_reason_why_acados_is_missing_is_told(tmp_path):
    _, _, missing = set_up(acados_makers(None), lambda name: None)
    assert list(missing) == ["acados sqp", "acados rti"]
    assert all("pip install comma-deps-acados" in reason for reason in missing.values())
    for python, reason in {
        "/no/such/python": "/no/such/python does not start: No such file",
        sys.executable: "No module named 'acados",
        script(tmp_path, "pass"): "python: ended without an answer",
    }.items():
        with pytest.raises(RuntimeError, match=reason):
            Acados("sqp", python)


def test_answers_of_the_process_are_returned(tmp_path):
    stand_in = (
        "import sys, numpy as np\n"
        "sys.stdout.buffer.write(b'\\n'); sys.stdout.flush()\n"
        "for status in (0.0, 4.0):\n"
        "    asked = np.frombuffer(sys.stdin.buffer.read(120))\n"
        "    answer = np.array([status, 7.0, asked[0], 2.0, asked[13] / 100.0])\n"
        "    sys.stdout.buffer.write(answer.tobytes()); sys.stdout.flush()\n"
    )
    acados = Acados("sqp", script(tmp_path, stand_in))
    case = PAPER_CASES[1]
    acados.start(case.goal)
    first = acados.solve(case.start, np.array([30.0, 0.0]))
    assert first.speeds.tolist() == [LIMIT, 30.0]
    assert first.solved is True and first.took == (7.0, 1.0)
    second = acados.solve(case.start, np.zeros(2))
    assert second.solved is False and second.took == (7.0, 0.0)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="process has ended"):
            acados.solve(case.start, np.zeros(2))


def test_times_measured_in_another_process_are_counted():
    class Elsewhere:
        def start(self, goal):
            pass

        def solve(self, state, input_in_force):
            return Answer(np.zeros(2), True, (2.0, 1.0))

    solvers, records, _ = set_up({"one": Elsewhere}, lambda name: None)
    for _ in run_closed_loops(solvers, records, [PAPER_CASES[1]], 2, 1, 60.0):
        pass
    assert records["one"].wall == [2.0, 2.0] and records["one"].cpu == [1.0, 1.0]
    assert records["one"].spent == 4.0
