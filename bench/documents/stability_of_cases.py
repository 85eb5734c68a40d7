# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frequency with which Eq. (42), the conclusion of Theorem 3, holds along Algorithm 1.

The algorithm as printed, started with u = 0 (Step 1) on the exact model. Prints the table of
``docs/model.md``:

    python bench/documents/stability_of_cases.py
"""

from dataclasses import replace

import numpy as np
from tables import header, row

from sphere_nmpc.control.stability import Sample, StabilityMonitor, StabilityReport
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector, make_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.problem import SolverSettings
from sphere_nmpc.solver.solve import solve
from sphere_sim.benchmark.problem import paper_problem, shifted
from sphere_sim.scenario.scenarios import PAPER_CASES, draw_scenarios
from sphere_sim.world.plant.rolling_plant import RollingPlant

_STEPS = 40
"""Samples of a run, 20 s."""
_ROBOT = RobotParameters()
_SETTINGS = ControllerSettings(strategy="paper")
_HEADINGS = np.linspace(0.03, 2.5, 19)
"""Errors of the heading alone [rad], from an upright start in place."""
_DRAWN = 12


def reports(start: Vector, goal: Vector) -> list[StabilityReport]:
    """Return the monitor's reports along Algorithm 1 between two states, (6,), one a sample."""
    limits = SolverSettings(max_iterations=_SETTINGS.max_iterations)
    plant, monitor = RollingPlant(_ROBOT, start), StabilityMonitor()
    guess: Vector = np.zeros((_SETTINGS.horizon, INPUT_SIZE))
    speeds, found = np.zeros(INPUT_SIZE), []
    beta = _SETTINGS.terminal_weight
    for k in range(_STEPS):
        state = plant.state
        problem = paper_problem(state, goal, speeds)
        solution = solve(replace(problem, max_step=_SETTINGS.longest_step), guess, limits)
        sample = Sample(
            time=k * _SETTINGS.period, state=state, goal=goal,
            # The problem is over beta and lacks the stage cost of the state itself.
            value=beta * solution.cost + float(np.sum((state - goal) ** 2)),
            next_input=solution.inputs[1], input_weight=_SETTINGS.alpha, terminal_weight=beta,
            max_speed=_ROBOT.max_rotor_speed,
        )
        found.append(monitor.update(sample))
        speeds, guess = solution.inputs[1], shifted(solution.inputs)
        plant.advance(speeds, _SETTINGS.period)
    return found


def _print_row(name: str, runs: list[list[StabilityReport]]) -> None:
    judged = sum(run[-1].judged for run in runs)
    holds = judged - sum(run[-1].violations for run in runs)
    nearer = judged - sum(run[-1].not_nearer for run in runs)
    entered = [next((r.time for r in run if r.inside), np.inf) for run in runs]
    reached = [time for time in entered if np.isfinite(time)]
    when = f"{min(reached):.1f} to {max(reached):.1f} s" if reached else "-"
    print(row(name, len(runs), judged, holds, nearer, len(reached), when))


def main() -> None:
    """Print the table."""
    print(header("runs", "number", "steps outside D", "Eq. (42) holds", "error falls", "reach D",
                 "after"))
    for case, scenario in PAPER_CASES.items():
        _print_row(f"case {case}", [reports(scenario.start, scenario.goal)])
    drawn = [reports(s.start, s.goal) for s in draw_scenarios(_DRAWN, seed=1)]
    _print_row("random", drawn)
    upright = make_state([0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    turned = [
        reports(upright, make_state([0.0, 0.0], [np.cos(a / 2), 0.0, 0.0, np.sin(a / 2)]))
        for a in _HEADINGS
    ]
    _print_row("upright, only the heading wrong", turned)


if __name__ == "__main__":
    main()
