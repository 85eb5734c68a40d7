# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Warnings about rotors that hold a momentum, and that what they advise helps."""

import re

import numpy as np
from momentum_loop import ROBOT, MomentumLoop

from sphere_nmpc.control.rotor_reserve import rotor_reserve
from sphere_nmpc.model.drift import NO_DRIFT, Drift, momentum_of_push, push_against
from sphere_nmpc.strategy.plan import PlanStatus

UPRIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def test_nothing_is_told_while_there_is_reserve_or_the_momentum_falls() -> None:
    assert rotor_reserve(NO_DRIFT, ROBOT, UPRIGHT) == {}
    small = Drift(np.array([0.0, 69.0, 0.0]), np.array([0.0, 7.0]))
    assert rotor_reserve(small, ROBOT, UPRIGHT) == {}
    assert rotor_reserve(Drift(np.array([0.0, 90.0, 0.0])), ROBOT, UPRIGHT) == {}
    falling = Drift(np.array([0.0, 90.0, 0.0]), np.array([0.0, -2.0]))
    assert rotor_reserve(falling, ROBOT, UPRIGHT) == {}


def test_time_that_is_left_is_told() -> None:
    drift = Drift(np.array([0.0, 80.0, 0.0]), np.array([0.0, 4.0]))
    ((kind, text),) = rotor_reserve(drift, ROBOT, UPRIGHT).items()
    assert kind == "rotors near their limit"
    assert "given 80 of 100 rad/s" in text and "and 5.0 s until" in text


def test_impulse_against_a_momentum_takes_it() -> None:
    momentum = np.array([30.0, -80.0, 0.0])
    np.testing.assert_allclose(momentum_of_push(ROBOT, push_against(ROBOT, momentum)), -momentum)


def test_push_that_is_advised_lets_the_sphere_return() -> None:
    loop = MomentumLoop(UPRIGHT, UPRIGHT)
    loop.tilt(np.radians(0.3))
    loop.run(18.0)
    loop.tilt(0.0)
    assert loop.run(2.0)[-1].status is PlanStatus.SATURATED, "a level floor alone does not help"
    (text,) = rotor_reserve(loop.drift, ROBOT, loop.goal).values()
    impulse, angle = re.findall(r"a push of (\S+) N s towards (\S+) deg", text)[0]
    turn = np.radians(float(angle))
    loop.plant.push(float(impulse) * np.array([np.cos(turn), np.sin(turn)]))
    loop.run(10.0)
    assert loop.error < 1e-2
    loop.check_limits()
