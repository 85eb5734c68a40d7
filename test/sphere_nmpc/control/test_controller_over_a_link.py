# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller over a link that delays and loses messages, in simulated time."""

import statistics

import numpy as np
import pytest
from simulated_link import LinkedLoop, LinkSettings, random_goals

from sphere_nmpc.model.parameters import RobotParameters

NO_LINK = LinkSettings(delay=0.0, jitter=0.0)
LARGEST_NOISE = 1e-3
"""Residual of predictions [m, -]: up to 5e-4 with measured rotor speeds, up to 1.5e-2 without."""


def times_to(goals: list[np.ndarray], loop: LinkedLoop) -> list[float]:
    times = [loop.go(goal) for goal in goals]
    reached = [time for time in times if time is not None]
    assert len(reached) == len(goals)
    return reached


def assert_plant_is_as_built(loop: LinkedLoop) -> None:
    estimator = loop.controller.estimator
    built = RobotParameters().lumped.as_array()
    np.testing.assert_allclose(estimator.plant.constants.as_array(), built, rtol=1e-3)
    assert estimator.plant.noise < LARGEST_NOISE
    assert estimator.drift.is_zero


@pytest.fixture(scope="module")
def alone() -> float:
    """Return the median of the times without a link [s]; nothing is then committed ahead."""
    loop = LinkedLoop(NO_LINK)
    times = times_to(random_goals(3, seed=1), loop)
    assert loop.schedule.window == 0.0
    assert loop.controller.rotor_feedback.loss == 0.0
    assert not loop.controller.rotor_feedback.shows_link
    return statistics.median(times)


@pytest.mark.parametrize("simulated", [True, False])
def test_lost_commands_are_no_other_plant_and_cost_little_time(
    simulated: bool, alone: float
) -> None:
    loop = LinkedLoop(LinkSettings(loss=0.2, simulated=simulated))
    times = times_to(random_goals(3, seed=1), loop)
    assert_plant_is_as_built(loop)
    assert 0.02 < loop.schedule.window < 0.3
    assert statistics.median(times) < 1.4 * alone


def test_goals_are_reached_through_bursts_of_loss() -> None:
    bursts = tuple(np.arange(2.0, 200.0, 8.0))
    loop = LinkedLoop(LinkSettings(loss=0.05, bursts=bursts))
    times_to(random_goals(2, seed=1), loop)
    assert_plant_is_as_built(loop)


def test_goals_are_reached_without_joint_states() -> None:
    loop = LinkedLoop(LinkSettings(loss=0.05, joint_states=False))
    times_to(random_goals(1, seed=1), loop)
    assert loop.schedule.window == 0.0
