# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Half motions and their meetings, compiled and plain."""

from collections.abc import Callable

import numpy as np
import pytest
from compiled_solver import compiled

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector, make_state, without_momentum
from sphere_nmpc.solver.half_motions import (
    Drives,
    Floats,
    Side,
    half_motions,
    knots_of,
    meet,
    plain_half_motions,
    plain_meet,
)
from sphere_nmpc.solver.roll_out import roll_out

CONSTANTS = RobotParameters().lumped.as_array()
DRIVES = Drives(period=0.25, ramp=0.25, limit=100.0)
COUNT, LEVELS = 320, 10
ROUNDING = 1e-3
"""Single precision has 7 digits; a turn of 10 rad/s amplifies an error some hundred times."""
SPEED = 0.742
REST = np.zeros(2)


def signals(seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    times = np.sort(rng.exponential(1.0, (2, 2, COUNT)), axis=1)
    times[:, 1, ::2] = 1e9
    signs = rng.choice([-1.0, 1.0], (2, COUNT))
    return np.concatenate((signs, times.reshape(4, COUNT))).astype(np.float32)


def both_sides(
    seed: int, begin: Vector = REST, motions: Callable[..., Side] = half_motions
) -> tuple[Side, Side]:
    rng = np.random.default_rng(seed)
    start, goal = (make_state(rng.uniform(-0.7, 0.7, 2), random_quaternion(rng)) for _ in "ab")
    forth, back = (
        motions(end, speeds, signals(seed), LEVELS, DRIVES, CONSTANTS)
        for end, speeds in ((start, begin), (goal, REST))
    )
    return forth, back


@pytest.mark.parametrize("motions", [half_motions, plain_half_motions])
@pytest.mark.parametrize("begin", [REST, np.array([70.0, -100.0])])
def test_states_are_those_of_the_solver_along_the_knots(motions, begin: Vector) -> None:
    assert compiled()
    found, _ = both_sides(1, begin, motions)
    knots = knots_of(signals(1), LEVELS, begin, DRIVES)
    durations = np.full(LEVELS, DRIVES.period)
    state = without_momentum(found.end)
    for i in range(0, COUNT, 16):
        expected = roll_out(state, knots[:, :, i], durations, CONSTANTS, DRIVES.period)
        np.testing.assert_allclose(found.states[:, :, i], expected[:, :6], atol=ROUNDING)
        steady = int(found.steady[i])
        assert np.all(np.abs(knots[steady:, :, i]) > 0.999 * DRIVES.limit)
        assert np.any(np.abs(knots[steady - 1, :, i]) < 0.999 * DRIVES.limit)
        corner = 2 * (knots[-1, 0, i] > 0.0) + (knots[-1, 1, i] > 0.0)
        assert found.corners[i] == corner


@pytest.mark.parametrize("ramp", [0.25, 0.6])
def test_knots_satisfy_the_limits(ramp: float) -> None:
    begin = np.array([-100.0, 30.0])
    knots = knots_of(signals(2), LEVELS, begin, Drives(0.25, ramp, 100.0))
    np.testing.assert_array_equal(knots[0], np.repeat(begin[:, None], COUNT, axis=1))
    # Switch times in single precision: 7 digits of 2.5 s over a ramp.
    assert np.max(np.abs(knots)) <= 100.0 + 1e-3
    assert np.max(np.abs(np.diff(knots, axis=0))) <= 100.0 * 0.25 / ramp + 1e-9


def test_both_find_the_same_meetings() -> None:
    forth, back = both_sides(3)
    found, plain = (
        each(forth, back, range(4, 2 * LEVELS), 10, 0.25, SPEED, turn_weight=2.0)
        for each in (meet, plain_meet)
    )
    assert found.pairs == plain.pairs > 1000
    np.testing.assert_allclose(found.scores, plain.scores, atol=1e-3)
    some = np.isfinite(found.scores)
    assert np.sum(some) >= 10
    same = found.partners[some] == plain.partners[some]
    assert np.mean(same) > 0.98  # but for ties within rounding


def test_pair_that_meets_is_a_motion_to_the_goal() -> None:
    forth, back = both_sides(4)
    found = meet(forth, back, range(4, 2 * LEVELS), 10, 0.25, SPEED, turn_weight=2.0)
    knots = knots_of(signals(4), LEVELS, REST, DRIVES)
    for i in np.argsort(found.scores)[:5]:
        j, periods = found.partners[i], int(found.periods[i])
        before, after = (periods + 1) // 2, periods // 2
        left, right = forth.states[before, :, i], back.states[after, :, j]
        apart = np.sum((left[:2] - right[:2]) ** 2) + 4.0 * (1.0 - abs(left[2:] @ right[2:]))
        assert found.scores[i] == pytest.approx(0.25 * periods + np.sqrt(apart) / SPEED, abs=1e-3)
        # The rotors go on as they are, and back along the way from the goal with opposite speeds.
        np.testing.assert_allclose(knots[before, :, i], -knots[after, :, j], atol=0.1)
        rest = -knots[: after + 1, :, j][::-1]
        durations = np.full(after, 0.25)
        begin = without_momentum(right.astype(float))
        end = roll_out(begin, rest, durations, CONSTANTS, 0.25)[-1, :6]
        np.testing.assert_allclose(end, back.end, atol=0.02)  # a step is not quite reversible
