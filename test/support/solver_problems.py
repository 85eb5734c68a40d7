# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Problems of the solvers, drawn at random."""

from typing import Any

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_nmpc.solver.problem import End, LeastSquaresProblem, MinimumTimeProblem, Problem

U_MAX = 100.0  # rad/s

MOMENTUM = np.array([30.0, -20.0, 15.0])
"""Momentum [rad/s] as after a push of about 1 N s."""
TORQUES = np.array([20.0, -5.0, 3.0, 4.0, -8.0])
"""A slope of about 1 degree, and the centre of mass 2 mm off."""

AT_SPEED: dict[str, Any] = {"end": End.STATE, "end_speeds": np.array([40.0, -25.0])}

LEAST_SQUARES: dict[str, dict[str, Any]] = {
    "paper": {"intervals": 4, "stage_weight": 1e-8, "input_weight": 5e-5},
    "terminal": {"intervals": 5, "input_weight": 1e-6},
    "one interval": {"intervals": 1, "input_weight": 1e-6},
    "acceleration": {
        "intervals": 9, "input_weight": 1e-8, "max_acceleration": 150.0, "position_scale": 0.4,
    },
    "stages and acceleration": {
        "intervals": 4, "stage_weight": 0.3, "input_weight": 1e-4, "max_acceleration": 150.0,
        "position_scale": 0.4,
    },
    "momentum": {
        "intervals": 9, "input_weight": 1e-4, "max_acceleration": 150.0, "momentum": MOMENTUM,
        "torques": TORQUES, "position_scale": 2.5,
    },
    "momentum and stages": {
        "intervals": 4, "stage_weight": 0.3, "input_weight": 1e-4, "momentum": MOMENTUM,
        "torques": TORQUES, "input_reference": np.array([30.0, -20.0]), "position_scale": 2.5,
    },
    "moving point": {
        "intervals": 5, "input_weight": 1e-6, "turn_weights": np.zeros(3),
        "goal_velocity": np.array([0.3, -0.1]), "position_scale": 2.5,
    },
    "moving and stages": {
        "intervals": 4, "stage_weight": 0.3, "input_weight": 1e-4,
        "turn_weights": np.array([0.5, 0.3, 0.0]), "goal_velocity": np.array([0.3, -0.1]),
        "position_scale": 0.4,
    },
    "at speed, momentum": {
        "intervals": 5, "input_weight": 1e-6, "momentum": MOMENTUM, "torques": TORQUES, **AT_SPEED,
    },
    "to rest, stages": {
        "intervals": 4, "stage_weight": 0.3, "input_weight": 1e-4, "end": End.REST,
    },
}
"""Problems of least squares."""

DISTURBED: dict[str, Any] = {
    "momentum": np.array([25.0, -40.0, 3.0]), "torques": np.array([8.0, -5.0, 3.0, 4.0, -2.0]),
    "momentum_row": np.array([0.01, -0.02, 0.015]), "position_scale": 2.5,
}
MOVING: dict[str, Any] = {
    "turn_weights": np.array([1.0, 1.0, 0.0]), "goal_velocity": np.array([0.3, -0.1]),
}
MINIMUM_TIME: dict[str, dict[str, Any]] = {
    kind: {"intervals": 9, "max_acceleration": 400.0, "error_weight": 100.0, **changes}
    for kind, changes in {
        "minimum time": {},
        "disturbed": DISTURBED,
        "whole turns": {
            "durations": np.array([0.3, 0.2, 0.25, 0.25, 15.0, 0.2, 0.3, 0.25, 0.1]),
            "steady_interval": 4, "steady_axis": np.array([0.6, -0.8]), "whole_turns": 13.7,
            "fixed": {3: (100.0, -100.0), 4: (100.0, -100.0)},
        },
        "moving in minimum time": MOVING,
        "moving, disturbed": {**DISTURBED, **MOVING},
        "at speed": AT_SPEED,
        "at speed, disturbed": {**DISTURBED, **AT_SPEED},
        "free end": {"end": End.FREE},
        "free end, disturbed": {**DISTURBED, "end": End.FREE},
        "effort": {"effort_weight": 0.2, "least_duration": 3.5},
        "effort, disturbed": {**DISTURBED, "effort_weight": 0.2},
    }.items()
}
KINDS = LEAST_SQUARES | MINIMUM_TIME


def make_problem(
    kind: str = "paper", seed: int = 0, unequal: bool = True, **changes: Any
) -> Problem:
    """Return a problem of a kind, with intervals of unequal length or of half a second.

    Knots that are `fixed`, by their indices, have their speeds [rad/s] as both bounds.
    """
    rng = np.random.default_rng(seed)
    settings = {**KINDS[kind], **changes}
    n, momentum = settings.pop("intervals"), settings.pop("momentum", np.zeros(3))
    fixed = settings.pop("fixed", {})
    turn = rng.normal(size=(2, 4))
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    defaults: dict[str, Any] = {
        "state": np.concatenate((as_state([*rng.uniform(-1.0, 1.0, 2), *turn[0]]), momentum)),
        "goal": as_state([0.0, 0.0, *turn[1]]),
        "input_in_force": rng.uniform(-50.0, 50.0, 2),
        "durations": rng.uniform(0.05, 0.5, n) if unequal else np.full(n, 0.5),
        "constants": RobotParameters().lumped.as_array(),
        "lower": np.full((n, 2), -U_MAX),
        "upper": np.full((n, 2), U_MAX),
        "input_scale": U_MAX,
    }
    record = MinimumTimeProblem if "error_weight" in settings else LeastSquaresProblem
    problem = record(**{**defaults, **settings})
    for knot, speeds in fixed.items():
        problem.lower[knot] = problem.upper[knot] = speeds
    return problem
