# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Decrease of the value function, or of the time left, along a run."""

import itertools
import math

from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.stability import Sample, StabilityMonitor
from sphere_nmpc.model.state import Vector
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import Value

_ROUNDING = 1e-9


def stability_of(
    decisions: list[Decision], goal: Vector, conditions: StudyConditions
) -> dict[str, Value]:
    """Count the steps that violate the decrease which a strategy's argument needs.

    The strategy ``paper`` has the value function of Theorem 3, which should decrease by the stage
    cost (Eq. 42) outside the neighbourhood D. ``time_optimal`` has the remaining time to the
    arrival, which has to decrease by the time that passes.

    Parameters
    ----------
    decisions : list of Decision
        One for each sampling instant.
    goal : ndarray, shape (6,)
        Goal of the run.
    conditions : StudyConditions
        Weights and limits.

    Returns
    -------
    dict
        ``stability_steps`` that could be evaluated and ``stability_violations`` among them.
    """
    if conditions.controller.strategy == "paper":
        return _value_decrease(decisions, goal, conditions)
    arrivals = [d.plan.arrival for d in decisions if d.solved]
    known = [a for a in arrivals if not math.isnan(a)]
    pairs = list(itertools.pairwise(known))
    broken = sum(b > a + _ROUNDING for a, b in pairs)
    return {"stability_steps": len(pairs), "stability_violations": broken}


def _value_decrease(
    decisions: list[Decision], goal: Vector, conditions: StudyConditions
) -> dict[str, Value]:
    monitor = StabilityMonitor()
    settings = conditions.controller
    judged = broken = 0
    for k, decision in enumerate(decisions):
        if decision.state is None or not decision.solved:
            continue
        report = monitor.update(
            Sample(
                time=k * settings.control_period,
                state=settings.units.scaled(decision.state),
                goal=settings.units.scaled(goal),
                value=decision.plan.cost,
                next_input=decision.plan.hold.speeds[1],
                input_weight=settings.alpha,
                terminal_weight=settings.terminal_weight,
                max_speed=conditions.robot.max_rotor_speed,
            )
        )
        judged, broken = report.judged, report.violations
    return {"stability_steps": judged, "stability_violations": broken}
