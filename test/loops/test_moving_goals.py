# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals that are given again and again: noisy, moving, and standing in the end."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from sampled_loop import SampledLoop

from sphere_nmpc.control.goal_motion import GoalMotion, current
from sphere_nmpc.model import rotation
from sphere_nmpc.model.goal import Goal, GoalSequence, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    POSITION,
    Vector,
    angle_error,
    make_state,
    position_error,
    state_error,
    upright_state,
)
from sphere_nmpc.settings import ControllerSettings

pytestmark = pytest.mark.slow

SPACING = 0.1
"""Time between two goals [s]."""
START = upright_state(0.0, 0.0, 0.0)
THERE = 8.0
"""Time after which the sphere has met its goal [s]; the motions take 2 to 6 s."""


class Kept(NamedTuple):
    """Medians once the goal is met, and the controller after the run."""

    position: float
    angle: float
    loop: SampledLoop


def line(velocity: Vector, seed: int, until: float = np.inf) -> Callable[[float], Vector]:
    """Return the pose of a goal by the time [s]; it stands from `until` on."""
    rng = np.random.default_rng(seed)
    begin, turn = rng.uniform(-1.0, 1.0, 2), rotation.random_quaternion(rng)
    return lambda time: make_state(begin + min(time, until) * velocity, turn)


def followed(
    goal: Callable[[float], Vector], kind: Orientation, noise: float = 0.0, duration: float = 16.0,
    gone: float = np.inf,
) -> Kept:
    """Return how near a goal is kept that is given with noise [m], until it is `gone` [s]."""
    rng, loop = np.random.default_rng(7), SampledLoop(START, ControllerSettings())
    errors, count = [], 0
    while (now := loop.simulator.time) < duration:
        if count % 5 == 0:
            loop.sample()
        if count % 2 == 0 and now < gone:
            given = goal(now).copy()
            given[POSITION] += noise * rng.standard_normal(2)
            loop.controller.set_goals(GoalSequence((Goal(given, kind),)), now)
        loop.advance(0.5 * SPACING)
        count += 1
        true = goal(loop.simulator.time)
        near = kind.nearest(true, loop.pose)
        errors.append((position_error(loop.pose, true), angle_error(loop.pose, near)))
    assert loop.controller.failures == 0
    position, angle = np.median(errors[int(THERE / (0.5 * SPACING)) :], axis=0)
    return Kept(float(position), float(np.degrees(angle)), loop)


@pytest.mark.parametrize(("noise", "position", "angle"), [(1e-3, 2e-3, 0.1), (5e-3, 1e-2, 3.0)])
def test_sphere_rests_at_a_noisy_goal(noise: float, position: float, angle: float) -> None:
    kept = followed(line(np.zeros(2), 1), Orientation.FULL, noise)
    assert kept.position < position and kept.angle < angle
    assert kept.loop.controller.at_goal


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5])
def test_point_that_moves_is_met_and_kept(speed: float) -> None:
    velocity = speed * np.array([0.8, -0.6])
    kept = followed(line(velocity, 2), Orientation.ANY)
    assert kept.position < 0.02
    controller = kept.loop.controller
    assert controller.goal_speed(kept.loop.simulator.time) == pytest.approx(speed, rel=1e-3)
    assert controller.at_goal


def test_noisy_point_that_moves_is_kept() -> None:
    assert followed(line(np.array([0.0, 0.3]), 3), Orientation.ANY, 5e-3).position < 0.02


def test_pose_that_moves_is_met_again_and_again() -> None:
    kept = followed(line(np.array([0.1, 0.0]), 4), Orientation.FULL, duration=24.0)
    assert kept.position < 0.15 and kept.angle < 30.0


@pytest.mark.parametrize("gone", [np.inf, 10.0], ids=["is still given", "is no longer given"])
def test_goal_that_stands_in_the_end_is_settled_at(gone: float) -> None:
    goal = line(np.array([0.1, 0.05]), 5, until=10.0)
    kept = followed(goal, Orientation.FULL, gone=gone, duration=20.0)
    assert kept.loop.controller.at_goal
    assert position_error(kept.loop.pose, goal(10.0)) < 0.02


def test_another_goal_is_no_motion() -> None:
    motion = GoalMotion()
    first, second = Goal(START), Goal(upright_state(1.0, 0.0, 0.0))
    assert motion.update(0.0, first)[1]
    assert motion.update(0.1, second)[1], "too far away"
    assert motion.update(1.0, second)[1], "too late"
    assert motion.update(1.1, Goal(second.pose, Orientation.ANY))[1], "demands less"
    assert not motion.update(1.2, Goal(second.pose, Orientation.ANY))[1]
    assert motion.update(1.2, Goal(second.pose, Orientation.ANY))[1], "the same time"


def test_goal_after_a_list_is_another_one_however_near_to_that_before_it() -> None:
    loop, near = SampledLoop(START), upright_state(0.05, 0.0, 0.0)
    controller = loop.controller
    assert controller.set_goals(GoalSequence((Goal(START),)), 0.0)
    assert controller.set_goals(GoalSequence((Goal(START), Goal(near))), 0.1)
    assert controller.set_goals(GoalSequence((Goal(near),)), 0.2)
    assert controller.goal_sequence.is_last


def test_rate_is_that_of_the_stamps_also_of_a_goal_that_turns() -> None:
    motion, rate = GoalMotion(), np.array([0.2, 0.1, 0.3, 0.0, -0.4])
    for k in range(30):
        # Not equally spaced.
        time = 0.1 * k + 0.03 * (k % 3)
        found, _ = motion.update(time, Goal(Goal(START, rate=rate).at(time)))
    np.testing.assert_allclose(found.rate, rate, atol=5e-3)
    assert position_error(found.at(5.0), Goal(START, rate=rate).at(5.0)) < 0.01
    assert not current(found, time + 1.0).rate.any(), "no longer given"


def test_pose_of_another_robot_that_rolls_is_followed() -> None:
    """The goal turns as it rolls, at 1 rad/s, and is given at 100 Hz."""
    motion, speed = GoalMotion(), 0.3
    rate = np.array([speed, 0.0, 0.0, speed / RobotParameters().shell_radius, 0.0])
    for k in range(500):
        found, is_other = motion.update(0.01 * k, Goal(Goal(START, rate=rate).at(0.01 * k)))
        assert not is_other or k == 0
        if k > 20:
            np.testing.assert_allclose(found.rate, rate, atol=1e-6)
    late, _ = motion.update(4.995, Goal(Goal(START, rate=rate).at(5.0)))
    assert state_error(late.at(5.0), Goal(START, rate=rate).at(5.0)) < 0.01, "the newest counts"


def test_goal_that_moves_in_another_way_is_noticed_at_once() -> None:
    motion = GoalMotion()
    for k in range(20):
        place = min(0.1 * k, 1.0) * 0.3
        found, is_other = motion.update(0.1 * k, Goal(upright_state(place, 0.0, 0.0)))
        assert not is_other or k == 0
        if k > 13:
            assert abs(found.rate[0]) < 1e-3
            assert position_error(found.pose, upright_state(0.3, 0.0, 0.0)) < 1e-3
