# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A goal near the start is reached as exactly as any other, unless it is within the dead band."""

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, make_state, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
SETTINGS = ControllerSettings()
START = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
EXACT = 2e-4
"""Final error of runs to distant goals [norm in R^6]; the largest of 132 scenarios is 1.5e-4."""


def final_error(goal: Vector) -> float:
    world = SimulatorSettings(
        initial_state=tuple(START)
    )
    run = run_closed_loop(
        Simulator(world, ROBOT), Controller(SETTINGS, ROBOT), goal, 6.0, SETTINGS.control_period
    )
    return state_error(run.states[-1], goal)


@pytest.mark.parametrize(
    "away",
    [
        [4e-3, 0.0, 0.0, 0.0, 0.0],
        [0.0, -3e-3, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 5e-3],
        [0.0, 0.0, 0.0, 0.0, 1e-2],
        [2e-3, -1e-3, 2e-3, 1e-3, -4e-3],
    ],
    ids=["4 mm ahead", "3 mm aside", "heading 5e-3", "heading 1e-2", "all"],
)
def test_goal_outside_the_dead_band_is_reached_exactly(away: list[float]) -> None:
    goal = apply_error(START, np.array(away))
    assert 2e-3 < state_error(START, goal) < 6e-3
    assert final_error(goal) < EXACT


def test_sphere_stays_at_a_goal_within_the_dead_band() -> None:
    """Wherever it stands: a manoeuvre that corrects a millimetre leads through large errors."""
    goal = apply_error(START, np.array([1.5e-3, 0.0, 0.0, 0.0, 0.0]))
    assert final_error(goal) == state_error(START, goal)
