# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller over a link that delays and loses messages, in simulated time."""

import statistics

import numpy as np
import pytest
from simulated_link import LinkedLoop, LinkSettings, random_goals

from sphere_nmpc.model.parameters import RobotParameters

NO_LINK = LinkSettings(delay=0.0, jitter=0.0)
GOALS = 6
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


def test_nothing_is_committed_ahead_without_a_link() -> None:
    loop = LinkedLoop(NO_LINK)
    times_to(random_goals(3, seed=1), loop)
    assert loop.schedule.window == 0.0
    assert loop.controller.rotor_feedback.loss == 0.0
    times_to(random_goals(7, seed=2), loop)
    assert not loop.controller.rotor_feedback.is_needed


@pytest.mark.parametrize("simulated", [True, False])
def test_lost_commands_are_no_other_plant(simulated: bool) -> None:
    loop = LinkedLoop(LinkSettings(loss=0.2, simulated=simulated))
    times_to(random_goals(3, seed=1), loop)
    assert_plant_is_as_built(loop)
    assert 0.02 < loop.schedule.window < 0.3


@pytest.fixture(scope="module")
def alone() -> float:
    """Return the median of the times without a link [s]."""
    return statistics.median(times_to(random_goals(GOALS, seed=1), LinkedLoop(NO_LINK)))


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "ratio"), [(0.0, 1.05), (0.05, 1.15), (0.2, 1.4)])
def test_goals_are_reached_about_as_early_as_without_a_link(
    loss: float, ratio: float, alone: float
) -> None:
    """The ratios are what a link may cost at these losses."""
    times = times_to(random_goals(GOALS, seed=1), LinkedLoop(LinkSettings(loss=loss)))
    assert statistics.median(times) < ratio * alone


@pytest.mark.slow
def test_goals_are_reached_through_bursts_of_loss() -> None:
    bursts = tuple(np.arange(2.0, 200.0, 8.0))
    loop = LinkedLoop(LinkSettings(loss=0.05, bursts=bursts, burst=2.0))
    times_to(random_goals(GOALS, seed=1), loop)
    assert_plant_is_as_built(loop)


@pytest.mark.slow
def test_goals_are_reached_without_joint_states() -> None:
    loop = LinkedLoop(LinkSettings(loss=0.05, joint_states=False))
    times_to(random_goals(3, seed=1), loop)
    assert loop.schedule.window == 0.0
