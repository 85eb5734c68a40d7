# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark: the same problem for all solvers, its counts, its command, acados elsewhere."""

import json
import sys

import numpy as np
import pytest

pytest.importorskip("rich")
pytest.importorskip("matplotlib")

from sphere_nmpc.solver.plain import expand
from sphere_sim.benchmark.acados import Acados, acados_makers
from sphere_sim.benchmark.closed_loops import SolverRecord, run_closed_loops, set_up
from sphere_sim.benchmark.nlp_solvers import nonlinear_program
from sphere_sim.benchmark.problem import LIMIT, Answer, paper_problem
from sphere_sim.benchmark.report import as_numbers
from sphere_sim.benchmark.solvers import ALGORITHM_1, PLAN_KEEPING, AlgorithmOne, BothSigns
from sphere_sim.cli.benchmark import main
from sphere_sim.scenario.scenarios import PAPER_CASES, draw_scenarios

pytestmark = pytest.mark.slow


class Idle:
    """Keeps the rotors at rest, with times that another process measured."""

    def start(self, goal):
        pass

    def solve(self, state, input_in_force):
        return Answer(np.zeros(2), True, (2.0, 1.0))


class Failing(Idle):
    def solve(self, state, input_in_force):
        raise ArithmeticError


def records_of(makers, cases, samples) -> dict[str, SolverRecord]:
    records, _ = set_up(makers, lambda name: None)
    for _ in run_closed_loops(records, [PAPER_CASES[case] for case in cases], samples, 1, 60.0):
        pass
    return records


def test_all_solvers_minimise_the_same_cost():
    import casadi as ca

    program = nonlinear_program()
    theirs = ca.Function("cost", [program["x"], program["p"]], [program["f"]])
    rng = np.random.default_rng(0)
    for scenario in draw_scenarios(5, 0):
        v, u = rng.uniform(-1.0, 1.0, 8), rng.uniform(-100.0, 100.0, 2)
        ours = expand(paper_problem(scenario.start, scenario.goal, u), v).cost
        assert float(theirs(v, np.concatenate((scenario.start, scenario.goal, u)))) == (
            pytest.approx(ours, rel=1e-12)
        )


def test_all_of_the_papers_cases_settle_in_time():
    # Limits: the best of the other solvers of this environment, on each case.
    settled = records_of({"one": BothSigns}, (1, 2, 3, 4), 30)["one"].settle
    for settle, limit in zip(settled, (10.5, 11.0, 4.5, 6.0), strict=True):
        assert settle is not None and settle <= limit
    assert None not in records_of({"one": AlgorithmOne}, (1, 3, 4), 30)["one"].settle


def test_solver_that_cannot_be_set_up_is_reported_with_the_reason():
    def absent():
        raise ModuleNotFoundError("No module named 'absent'", name="absent")

    def broken():
        raise OSError("no disc")

    makers = {"a": absent, "b": broken, "c": Idle, **acados_makers(None)}
    records, missing = set_up(makers, lambda name: None)
    assert list(records) == ["c"]
    assert missing.pop("a") == "not installed (absent)"
    assert missing.pop("b") == "could not be set up: no disc"
    assert list(missing) == ["acados sqp", "acados rti"]
    assert all("pip install comma-deps-acados" in reason for reason in missing.values())


def test_failures_times_and_runs_that_never_settle_are_counted():
    records = records_of({"idle": Idle, "raising": Failing}, (2,), 3)
    numbers = as_numbers(records, {})["solvers"]
    assert numbers["idle"]["failures"] == 0 and numbers["raising"]["failures"] == 3
    assert numbers["idle"]["settle_s"] == [None] and numbers["raising"]["solves"] == 3
    assert records["idle"].wall == [2.0] * 3 and records["idle"].cpu == [1.0] * 3


def test_answers_of_acados_come_from_another_python(tmp_path):
    for python, words in (
        ("/no/such/python", "/no/such/python does not start: No such file"),
        (sys.executable, "No module named 'acados"),
    ):
        with pytest.raises(RuntimeError, match=words):
            Acados("sqp", python)
    stand_in = tmp_path / "python"
    stand_in.write_text(
        f"#!{sys.executable}\n"
        "import sys; sys.path.append(sys.argv[3])\n"
        "from sphere_nmpc.process.channel import Channel, encoded\n"
        "channel = Channel.inherited(int(sys.argv[-1])); channel.send(encoded(''))\n"
        "for status in (0, 4):\n"
        "    *_, in_force, starts = channel.receive()\n"
        "    inputs = [2.0, in_force[0] / 100.0]\n"
        "    channel.send(encoded((status, 7.0, float(starts), inputs)))\n"
    )
    stand_in.chmod(0o755)
    acados = Acados("sqp", str(stand_in))
    case = PAPER_CASES[1]
    acados.start(case.goal)
    first = acados.solve(case.start, np.array([30.0, 0.0]))
    assert first.speeds.tolist() == [LIMIT, 30.0]
    assert first.solved is True and first.took == (7.0, 1.0)
    second = acados.solve(case.start, np.zeros(2))
    assert second.solved is False and second.took == (7.0, 0.0)
    with pytest.raises(RuntimeError, match="process has ended"):
        acados.solve(case.start, np.zeros(2))


def test_command_writes_numbers_table_and_figure(tmp_path, capsys):
    path = tmp_path / "deep" / "benchmark.json"
    words = "--quick --cases 3 --duration 2 --budget 1 --random 5 --json"
    assert main([*words.split(), str(path)]) == 0
    report = json.loads(path.read_text())
    for name in (ALGORITHM_1, PLAN_KEEPING):
        ours = report["solvers"][name]
        assert {"median_ms", "p99_ms", "settle_s", "failures"} <= set(ours)
        assert ours["failures"] == 0 and len(ours["settle_s"]) == 1
    assert report["random"]["problems"] == 5 and report["random"]["8_starts_not_worse"] >= 0.8
    assert path.with_suffix(".png").stat().st_size > 1000
    assert "Closed loops on the paper's problem" in capsys.readouterr().out


@pytest.mark.parametrize(
    "wrong",
    [["--rounds", "0"], ["--duration", "0.5"], ["--budget", "nan"], ["--json", "figure.png"],
     ["--json", "/"]],
    ids=" ".join,
)
def test_invalid_arguments_are_refused(wrong, tmp_path):
    with pytest.raises(SystemExit, match="2"):
        main(["--json", str(tmp_path / "x.json"), *wrong])
