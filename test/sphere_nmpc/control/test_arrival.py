# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The arrival is detected when the error stays small, not when it passes through zero."""

import math

import pytest

from sphere_nmpc.control.arrival import Arrival
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Mode
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

TOLERANCE, DWELL = 0.01, 0.25


def reached(*samples: tuple[float, float]) -> list[bool]:
    """Return whether the goal counts as reached at each (time, error)."""
    arrival = Arrival()
    return [arrival.update(time, error, TOLERANCE, DWELL) for time, error in samples]


@pytest.mark.parametrize(
    ("samples", "expected"),
    [
        ([(0.0, 0.009), (0.24, 0.009), (0.25, 0.009)], [False, False, True]),
        ([(0.0, 0.009), (0.1, 0.011), (0.3, 0.009)], [False, False, False]),
        ([(0.0, 0.0), (0.3, 0.0), (0.4, 0.019), (0.5, 0.021)], [False, True, True, False]),
        ([(0.0, 0.0), (0.3, 0.0), (0.4, 0.021), (0.5, 0.015)], [False, True, False, False]),
        ([(0.0, math.nan), (0.3, math.nan)], [False, False]),
        ([(5.0, 0.0), (0.0, 0.0), (0.1, 0.0), (0.3, 0.0)], [False, False, False, True]),
    ],
    ids=["stays", "passes", "noise at the limit", "pushed away", "unknown", "clock set back"],
)
def test_goal_is_reached_when_the_error_stays_within_the_tolerance(samples, expected) -> None:
    assert reached(*samples) == expected


def test_time_taken_counts_from_the_first_sample_or_from_when_the_goal_was_left() -> None:
    arrival = Arrival()
    taken = []
    for time, error in (
        (1.0, math.nan), (1.5, 1.0), (4.14, 0.005), (4.5, 0.001),  # reached after 3.14 s
        (5.0, 0.5), (6.0, 0.1), (7.5, 0.001), (8.0, 0.001),  # pushed away at 5 s
    ):
        if arrival.update(time, error, TOLERANCE, DWELL) and arrival.took not in taken:
            taken.append(arrival.took)
    assert taken == pytest.approx([3.14, 2.5])
    arrival.reset()  # the pose was lost at the goal
    arrival.update(9.0, 0.02, TOLERANCE, DWELL)
    arrival.reset()  # and on the way back
    for time, error in ((10.0, 0.02), (10.5, 0.001), (11.0, 0.001)):
        arrival.update(time, error, TOLERANCE, DWELL)
    assert arrival.reached and arrival.took == pytest.approx(1.5)


@pytest.mark.slow
@pytest.mark.parametrize("case", PAPER_CASES)
def test_paper_case_ends_in_the_mode_at_goal_once_it_has_settled(case: int) -> None:
    scenario, settings, robot = PAPER_CASES[case], ControllerSettings(), RobotParameters()
    world = SimulatorSettings(
        initial_state=tuple(scenario.start)
    )
    controller = Controller(settings, robot)
    run = run_closed_loop(
        Simulator(world, robot), controller, scenario.goal, 12.0, settings.control_period
    )
    assert controller.at_goal and run.decisions[-1].mode is Mode.AT_GOAL
    first = next(i for i, d in enumerate(run.decisions) if d.mode is Mode.AT_GOAL)
    assert all(d.mode is Mode.AT_GOAL for d in run.decisions[first:]), "without flicker"
    assert run.decisions[first - 1].error < settings.goal_tolerance
    assert all(d.solved for d in run.decisions)
