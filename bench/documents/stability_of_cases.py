# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frequency with which the conditions of Theorem 3 hold along the paper's four cases.

Prints the table of ``docs/model.md``:

    python bench/documents/stability_of_cases.py
"""

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.stability import Sample, StabilityMonitor, StabilityReport
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

DURATION = 20.0


def reports(case: int) -> list[StabilityReport]:
    """Return the monitor's reports on a case run without noise, one a sample."""
    scenario, robot = PAPER_CASES[case], RobotParameters()
    settings = ControllerSettings(strategy="paper")
    simulator = Simulator(SimulatorSettings(initial_state=tuple(scenario.start)), robot)
    period = settings.period
    run = run_closed_loop(
        simulator, Controller(settings, robot), scenario.goal, DURATION, period, period
    )
    monitor = StabilityMonitor()
    return [
        monitor.update(
            Sample(
                time=k * period,
                state=state,
                goal=scenario.goal,
                value=decision.plan.cost,
                next_input=decision.plan.hold.speeds[1],
                input_weight=settings.alpha,
                terminal_weight=settings.terminal_weight,
                max_speed=robot.max_rotor_speed,
            )
        )
        for k, (decision, state) in enumerate(zip(run.decisions, run.states, strict=False))
    ]


def main() -> None:
    print("| case | steps outside D | Eq. (42) holds | Delta < 0 | Eq. (36) holds | in D from |")
    print("|---|---|---|---|---|---|")
    for case in PAPER_CASES:
        found = reports(case)
        last = found[-1]
        judged = last.judged
        inside = next(report.time for report in found if report.inside)
        print(
            f"| {case} | {judged} | {judged - last.decrease_violations} "
            f"| {judged - last.approach_violations} | {judged - last.beta_violations} "
            f"| {inside:.1f} s |"
        )


if __name__ == "__main__":
    main()
