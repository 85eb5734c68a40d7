# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lag and limits of drives from commands and rotor speeds."""

import numpy as np
import pytest

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_sim.evaluation.series import Series
from sphere_sim.identification.drives import Commands, identified_drives
from sphere_sim.world.drives import CommandFollower

SPEED, ACCELERATION, LAG = 96.0, 370.0, 0.013
TIMES = np.arange(0.0, 20.0, 0.01)


def followed(wanted: np.ndarray, noise: float = 0.05) -> Series:
    """Return measured speeds at `TIMES` of drives that get commands there, without a lag."""
    follower, speeds, found = CommandFollower(SPEED, ACCELERATION, 0.5), np.zeros(2), []
    for time, command in zip(TIMES, wanted, strict=True):
        found.append(speeds)
        follower.follow_speeds(command, float(time))
        speeds = follower.speeds_after(speeds, float(time), 0.01)
    measured = np.array(found) + noise * np.random.default_rng(1).normal(size=(TIMES.size, 2))
    return Series(TIMES, measured)


def sent(wanted: np.ndarray, late: float = -LAG) -> Commands:
    """Return commands of speeds at `TIMES`, later by a time [s]."""
    return Commands.of_speeds(Series(TIMES + late, wanted))


def steps(largest: float) -> np.ndarray:
    rng = np.random.default_rng(2)
    return np.repeat(rng.uniform(-largest, largest, (TIMES.size // 50, 2)), 50, axis=0)


def test_lag_and_both_limits_are_found_where_commands_exceed_them() -> None:
    wanted = steps(120.0)
    found = identified_drives(sent(wanted), followed(wanted))
    assert found is not None and found.acceleration is not None and found.speed is not None
    assert found.lag[0] == pytest.approx(LAG, abs=1e-4)
    assert found.acceleration[0] == pytest.approx(ACCELERATION, rel=1e-3)
    assert found.speed[0] == pytest.approx(SPEED, rel=1e-3)
    assert found.left == pytest.approx(0.05, rel=0.1)


def test_limit_that_is_not_reached_is_not_told() -> None:
    wanted = steps(80.0)
    found = identified_drives(sent(wanted), followed(wanted))
    assert found is not None and found.acceleration is not None
    assert found.speed is None and found.attained[1] <= 80.0
    hold = FirstOrderHold(np.array([0.0, 5.0, 10.0, 19.0]), 50.0 * np.array(
        [[0, 0], [1, -1], [-1, 1], [0, 0]]
    ))
    wanted = np.array([hold.at(time + 0.01) for time in TIMES])
    commands = Commands.of_holds([hold.delayed(-LAG)])
    found = identified_drives(commands, followed(wanted))
    assert found is not None and found.acceleration is None and found.speed is None
    assert found.lag[0] == pytest.approx(LAG, abs=1e-3)


def test_limit_that_small_steps_alone_would_show_is_not_told() -> None:
    wanted = 5.0 * np.sin(TIMES)[:, None] * np.ones(2)
    wanted[::200] += 0.02  # as where a plan replaces another one
    found = identified_drives(sent(wanted), followed(wanted))
    assert found is not None and found.acceleration is None


def test_trajectory_counts_until_the_next_one_starts() -> None:
    knots = np.array([0.0, 10.0])
    first = FirstOrderHold(knots, np.array([[0.0, 0.0], [10.0, 20.0]]))
    second = FirstOrderHold(knots + 5.0, np.array([[5.0, 10.0], [0.0, 0.0]]))
    found = Commands.of_holds([second, first])
    assert found.times.tolist() == [0.0, 5.0, 5.0, 15.0]
    assert found.speeds[:, 0].tolist() == [0.0, 5.0, 5.0, 0.0]


def test_without_motion_or_commands_beside_speeds_nothing_is_found() -> None:
    still = np.zeros((TIMES.size, 2))
    assert identified_drives(sent(still), Series(TIMES, still)) is None
    assert identified_drives(sent(steps(80.0), 100.0), followed(steps(80.0))) is None
