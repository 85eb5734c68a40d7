# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""acados in a process of another Python."""

import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("rich")

from sphere_nmpc.child_command import python_command
from sphere_nmpc.model.integrator import integrate
from sphere_nmpc.solver.reference.objective import cost
from sphere_sim.benchmark import acados_solver
from sphere_sim.benchmark.acados_solver import Acados, acados_makers, clean_environment
from sphere_sim.benchmark.benchmarked_solver import Answer
from sphere_sim.benchmark.closed_loops import run_closed_loops, set_up
from sphere_sim.benchmark.problem import (
    CONSTANTS,
    HORIZON,
    INTEGRATION_STEP,
    LIMIT,
    SAMPLE_PERIOD,
    paper_problem,
)
from sphere_sim.scenario.scenarios import PAPER_CASES, draw_scenarios

PYTHON = os.environ.get("SPHERE_TEST_ACADOS_PYTHON")
needs_acados = pytest.mark.skipif(
    PYTHON is None, reason="SPHERE_TEST_ACADOS_PYTHON does not name a Python that has acados"
)

# Reads rows of x_0 ... x_N (8 each), v_0 ... v_{N-1} and the goal; writes acados' cost and gap.
# Its cost has its weights only once it has solved something.
EVALUATE = """
import os, sys, tempfile
from pathlib import Path
import numpy as np
from sphere_sim.benchmark.acados_process import Loop, build

def put(solver, x, v):
    for k in range(5):
        solver.set(k, "x", x[k])
    for k in range(4):
        solver.set(k, "u", v[k])

rows = np.frombuffer(sys.stdin.buffer.read()).reshape(-1, 54)
answers = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)
with tempfile.TemporaryDirectory() as folder:
    os.chdir(folder)
    solver = build("sqp", Path(folder))
    for row in rows:
        x, v, goal = row[:40].reshape(5, 8), row[40:48].reshape(4, 2), row[48:]
        Loop(solver).start(x[0, :6], goal)
        solver.set(0, "lbx", x[0])
        solver.set(0, "ubx", x[0])
        put(solver, x, v)
        solver.solve()
        gap = solver.get_stats("statistics")[2, 0]  # before the first step
        put(solver, x, v)
        answers.write(np.array([solver.get_cost(), gap]).tobytes())
    os.chdir("/")
"""


def script(tmp_path, text):
    """Return a stand-in for the other Python, which runs `text` with this one."""
    path = tmp_path / "python"
    path.write_text(f"#!{sys.executable}\n{text}\n")
    path.chmod(0o755)
    return str(path)


def test_without_an_interpreter_the_reason_says_how_to_get_one():
    _, _, missing = set_up(acados_makers(None), lambda name: None)
    assert list(missing) == ["acados sqp", "acados rti"]
    assert all("pip install comma-deps-acados" in reason for reason in missing.values())


def test_missing_interpreter_is_named():
    with pytest.raises(RuntimeError, match=r"/no/such/python does not start: No such file"):
        Acados("sqp", "/no/such/python")


def test_interpreter_without_acados_is_reported():
    with pytest.raises(RuntimeError, match="No module named 'acados"):
        Acados("sqp", sys.executable)


def test_program_that_is_no_interpreter_is_reported(tmp_path):
    with pytest.raises(RuntimeError, match="python: ended without an answer"):
        Acados("sqp", script(tmp_path, "pass"))


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


@needs_acados
@pytest.mark.slow
def test_acados_has_the_same_cost_and_dynamics():
    rng = np.random.default_rng(0)
    rows, expected = [], []
    for scenario in draw_scenarios(5, 0):
        v, in_force = rng.uniform(-1.0, 1.0, 2 * HORIZON), rng.uniform(-LIMIT, LIMIT, 2)
        knots = np.vstack((in_force, LIMIT * v.reshape(-1, 2)))
        states = [scenario.start]
        for last, there in pairwise(knots):
            sample = (SAMPLE_PERIOD, CONSTANTS, INTEGRATION_STEP)
            states.append(integrate(states[-1], last, there, *sample))
        rows.append(np.concatenate((np.hstack((states, knots / LIMIT)).ravel(), v, scenario.goal)))
        expected.append(cost(paper_problem(scenario.start, scenario.goal, in_force), v)[0])
    done = subprocess.run(
        python_command(
            acados_solver.IMPORT_PATH + EVALUATE, acados_solver.PACKAGES, python=PYTHON
        ),
        input=np.array(rows).tobytes(),
        env=clean_environment(),
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    costs, gaps = np.frombuffer(done.stdout).reshape(-1, 2).T
    assert costs == pytest.approx(expected, rel=1e-12)
    assert gaps.max() < 1e-12


@needs_acados
@pytest.mark.slow
@pytest.mark.parametrize("kind", ("sqp", "rti"))
def test_acados_solves_and_removes_its_files(kind, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    acados = Acados(kind, PYTHON)
    case = PAPER_CASES[3]
    acados.start(case.goal)
    answer = acados.solve(case.start, np.zeros(2))
    assert np.all(np.abs(answer.speeds) <= LIMIT) and np.any(answer.speeds != 0.0)
    assert answer.took is not None and answer.took[0] > 0.0
    assert list(tmp_path.iterdir())
    acados.close()
    assert not list(tmp_path.iterdir())
