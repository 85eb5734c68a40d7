# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark: the same problem for all solvers, its counts, its command."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rich")
pytest.importorskip("matplotlib")

from patience import PATIENCE

from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import SolverSettings
from sphere_nmpc.solver.reference.objective import cost
from sphere_sim.benchmark import numpy_slsqp
from sphere_sim.benchmark.closed_loops import run_closed_loops, set_up
from sphere_sim.benchmark.nlp_solvers import ipopt, nonlinear_program
from sphere_sim.benchmark.problem import Answer, paper_problem
from sphere_sim.benchmark.random_problems import Comparison, compare
from sphere_sim.benchmark.report import as_numbers
from sphere_sim.benchmark.solvers import ALGORITHM_1, PLAN_KEEPING, AlgorithmOne, BothSigns
from sphere_sim.cli.benchmark import main
from sphere_sim.cli.main import main as command
from sphere_sim.scenario.scenarios import PAPER_CASES, draw_scenarios


class Idle:
    """Keeps the rotors at rest; may fail."""

    def __init__(self, raises=False):
        self._raises = raises

    def start(self, goal):
        pass

    def solve(self, state, input_in_force):
        if self._raises:
            raise ArithmeticError
        return Answer(np.zeros(2), True)


def settling_times(maker, cases, duration=15.0):
    solvers, records, _ = set_up({"one": maker}, lambda name: None)
    scenarios = [PAPER_CASES[case] for case in cases]
    for _ in run_closed_loops(solvers, records, scenarios, round(duration / 0.5), 1, 60.0):
        pass
    return records["one"].settle


def test_solve_that_has_stalled_counts_as_failed():
    solver, case = AlgorithmOne(), PAPER_CASES[1]
    solver.start(case.goal)
    assert solver.solve(case.start, np.zeros(2)).solved
    # Neither tolerance can be met, so that the solve ends where no step lowers the cost.
    solver._solver = HoldSolver(
        SolverSettings(10_000, gradient_tolerance=0.0, decrease_tolerance=0.0)
    )
    solver.start(case.goal)
    assert not solver.solve(case.start, np.zeros(2)).solved


def test_all_solvers_minimise_the_same_cost():
    import casadi as ca

    program = nonlinear_program()
    theirs = ca.Function("cost", [program["x"], program["p"]], [program["f"]])
    rng = np.random.default_rng(0)
    for scenario in draw_scenarios(5, 0):
        v, u = rng.uniform(-1.0, 1.0, 8), rng.uniform(-100.0, 100.0, 2)
        ours, _ = cost(paper_problem(scenario.start, scenario.goal, u), v)
        assert float(theirs(v, np.concatenate((scenario.start, scenario.goal, u)))) == (
            pytest.approx(ours, rel=1e-12)
        )
        in_numpy = numpy_slsqp.costs_at(v[None, :], scenario.start, scenario.goal, u)[0]
        assert in_numpy == pytest.approx(ours, rel=1e-12)


def test_all_of_the_papers_cases_settle_in_time():
    # Limits: the best of the other solvers of this environment, on each case.
    for settle, limit in zip(
        settling_times(BothSigns, (1, 2, 3, 4)), (10.5, 11.0, 4.5, 6.0), strict=True
    ):
        assert settle is not None and settle <= limit
    for settle in settling_times(AlgorithmOne, (1, 3, 4)):
        assert settle is not None


def test_solver_that_cannot_be_set_up_is_reported():
    def absent():
        raise ModuleNotFoundError("No module named 'absent'", name="absent")

    def broken():
        raise OSError("no disc")

    def silent():
        raise AssertionError

    makers = {"a": absent, "b": broken, "c": silent, "d": Idle}
    _, records, missing = set_up(makers, lambda name: None)
    assert missing == {
        "a": "not installed (absent)",
        "b": "could not be set up: no disc",
        "c": "could not be set up: AssertionError",
    }
    assert list(records) == ["d"]


def test_failures_are_counted_and_never_settling_is_none():
    makers = {"idle": Idle, "raising": lambda: Idle(raises=True)}
    solvers, records, _ = set_up(makers, lambda name: None)
    for _ in run_closed_loops(solvers, records, [PAPER_CASES[2]], 3, 1, 60.0):
        pass
    report = as_numbers(records, {})
    assert records["idle"].failures == 0 and records["raising"].failures == 3
    assert report["solvers"]["idle"]["settle_s"] == [None]
    assert report["solvers"]["raising"]["solves"] == 3


@pytest.mark.slow
def test_many_starts_are_not_worse_than_ipopt():
    comparison = Comparison()
    for _ in compare(ipopt(), 20, 0, comparison):
        pass
    summary = comparison.summary()
    assert summary["problems"] == 20
    assert summary["8_starts_not_worse"] >= 0.95


@pytest.mark.slow
def test_command_writes_numbers_table_and_figure(tmp_path, capsys):
    path = tmp_path / "deep" / "benchmark.json"
    quick = ["--quick", "--cases", "3", "--duration", "10", "--budget", "3"]
    assert main(["--json", str(path), *quick]) == 0
    report = json.loads(path.read_text())
    for name in (ALGORITHM_1, PLAN_KEEPING):
        ours = report["solvers"][name]
        assert {"median_ms", "p99_ms", "settle_s", "failures"} <= set(ours)
        assert ours["failures"] == 0 and len(ours["settle_s"]) == 1
    assert path.with_suffix(".png").stat().st_size > 1000
    assert "Closed loops on the paper's problem" in capsys.readouterr().out


@pytest.mark.parametrize(
    "wrong",
    [
        ["--rounds", "0"], ["--random", "-1"], ["--duration", "0.5"], ["--duration", "1e6"],
        *([name, n] for name in ("--duration", "--budget") for n in ("nan", "inf", "-1")),
        ["--json", "figure.png"], ["--json", "/"],
    ],
    ids=" ".join,
)
def test_invalid_arguments_are_refused(wrong, tmp_path):
    with pytest.raises(SystemExit) as stopped:
        main(["--json", str(tmp_path / "x.json"), *wrong])
    assert stopped.value.code == 2


QUICK = ["--quick", "--cases", "3", "--duration", "2", "--budget", "1"]


def test_interrupt_leaves_the_numbers_so_far_beside_those_of_a_whole_run(
    tmp_path, monkeypatch, capsys
):
    def interrupt(*_):
        raise KeyboardInterrupt

    (tmp_path / "x.json").write_text("{}")
    monkeypatch.setattr("sphere_sim.benchmark.random_problems.compare", interrupt)
    path = str(tmp_path / "x.json")
    assert command(["benchmark", "--json", path, "--random", "1", *QUICK]) == 130
    kept = tmp_path / "x_interrupted.json"
    assert json.loads(kept.read_text())["solvers"][ALGORITHM_1]["solves"] == 4
    assert f"interrupted; {kept} has the numbers so far" in capsys.readouterr().err
    assert (tmp_path / "x.json").read_text() == "{}"


def test_interrupt_ends_the_benchmark_during_any_solver(tmp_path):
    """Solvers of other libraries may handle interrupts themselves."""
    command = "from sphere_sim.cli.main import main; exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", command, "benchmark", "--json", str(tmp_path / "x.json"),
         "--quick", "--rounds", "1000", "--budget", "1000", "--duration", "1000"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    try:
        while "libipopt" not in Path(f"/proc/{process.pid}/maps").read_text():
            assert process.poll() is None
            time.sleep(0.05)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, message = process.communicate(timeout=PATIENCE)  # the benchmark takes longer
    finally:
        process.kill()
    assert process.returncode == 130 and "interrupted" in message and "Traceback" not in message
    assert not (tmp_path / "x.json").exists()
