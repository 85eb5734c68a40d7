# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops along paths."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from floor_plans import floor_of, least_distance
from given_paths import CIRCLE, CORNER, CUSP, EIGHT, LINE, RADIUS, SHAPES
from robots import PALM
from sampled_loop import ROBOT, SampledLoop, check_hold

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector, make_state, upright_state
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.evaluation.metrics import deviations, measure_along
from sphere_sim.scenario.perturbation import perturbed

pytestmark = pytest.mark.slow

SETTINGS = ControllerSettings(path_speed=0.3)
RMS, LARGEST = 1.5e-3, 6e-3
"""What is asked for on the ideal plant [m]; 0.15 and 0.7 mm are usual."""
MOMENTUM = np.array([8.0, -6.0, 0.0])


class Along(SampledLoop):
    """Loop that follows the paths through places, from a random orientation at the first one."""

    def __init__(self, places: Vector, seed: int = 1, settings: ControllerSettings = SETTINGS,
                 end: Vector | None = None, **others: Any) -> None:
        start = make_state(places[0], random_quaternion(np.random.default_rng(seed)))
        super().__init__(start, settings, **others)
        self.paths = Path.through(places, settings.path_tolerance, self.nominal.shell_radius)
        course = Course.along(*self.paths, end=None if end is None else Goal(end))
        self.controller.following.take(ActiveCourse(course, 1))

    def away(self, since: float = 0.0) -> float:
        """Return the largest deviation from a time on [m]."""
        away, _ = deviations(self.paths, self.places, 0.1)
        return float(np.max(away[np.array(self.times) >= since]))

    def run_to_the_end(self) -> tuple[float, float, float]:
        """Run until the end is reached; return rms and largest deviation [m] and duration [s]."""
        while not self.controller.at_goal:
            assert self.time < 30.0, self.decision
            self.run(self.settings.control_period)
        assert self.controller.failures == 0, self.controller.last_failure
        for hold in self.holds:
            check_hold(hold, self.nominal)
        return measure_along(np.array(self.times), self.places, self.paths, 0.1)


@pytest.mark.parametrize("seed", range(6))
def test_line_is_followed_through_gamma_from_any_orientation(seed) -> None:
    rms, largest, duration = Along(LINE, seed).run_to_the_end()
    assert rms < RMS and largest < LARGEST
    assert 1.0 < duration / (2.0 / 0.3) < 1.1  # with start and end, and a turn on Gamma


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("speed", "slower", "rate"), [(0.3, 1.1, 0.0), (0.0, 1.6, 100.0)])
def test_whole_path_is_followed_within_the_limits(shape, speed, slower, rate) -> None:
    loop = Along(SHAPES[shape], 2, replace(SETTINGS, control_rate=rate, path_speed=speed))
    rms, largest, duration = loop.run_to_the_end()
    assert rms < RMS and largest < LARGEST
    assert 1.0 < duration / (loop.paths[0].length / (speed or 0.742)) < slower


def test_closed_path_is_not_reached_at_its_start() -> None:
    loop = Along(CIRCLE)
    for share in (0.0, 0.3, 0.9):
        loop.run(share * np.pi / 0.3 - loop.time)
        loop.sample()
        tracked = loop.controller.following.tracking()
        assert not loop.controller.at_goal and abs(tracked.way - share * np.pi) < 0.2
        assert tracked.way + tracked.way_left == pytest.approx(loop.paths[0].length)


def test_path_with_a_cusp_rests_there_and_ends_in_a_full_pose() -> None:
    goal = upright_state(*CUSP[2], 1.0)
    loop = Along(CUSP, end=goal)
    loop.run_to_the_end()
    near = np.linalg.norm(loop.places - CUSP[1], axis=1) < 2e-3
    assert np.min(np.max(np.abs(np.array(loop.speeds)[near]), axis=1)) < 1.0
    last = np.argmax(np.linalg.norm(loop.places - CUSP[2], axis=1) < 5e-3)
    assert np.max(deviations(loop.paths, loop.places[:last], 0.1)[0]) < LARGEST
    assert loop.error(goal) < 1e-2


def test_pushed_sphere_comes_back_to_the_path() -> None:
    loop = Along(CIRCLE)
    for pushed, duration in ((0.0, 2.0), (1.0, 1.0), (-1.0, 3.0)):
        loop.push_momentum(pushed * MOMENTUM)
        loop.run(duration)
    assert 0.01 < loop.away() < 0.1 and loop.away(since=5.0) < 2e-3
    loop.push_momentum(MOMENTUM)
    loop.run(3.0)
    # While it stays, plans do not foresee the turn about the body's z axis.
    assert loop.away() < 0.1
    loop.run_to_the_end()


NOISES = {"pose_position_noise": 2e-3, "pose_orientation_noise": 2e-3}
NOISY = {"position_noise": 2e-3, "orientation_noise": 2e-3, "seed": 1}
WRONG = perturbed(ROBOT, 0.1, np.random.default_rng(1))


@pytest.mark.parametrize("changes, others", [
    ({}, {"robot": WRONG, "delay": 0.03}), ({"path_speed": 0.0}, {"robot": WRONG}),
    (NOISES | {"path_speed": 0.0}, {"simulated": NOISY}),
    (NOISES, {"simulated": NOISY | {"plant": "rigid_body"}, "robot": WRONG}),
], ids=["10 % wrong, late", "10 % wrong, fast", "2 mm of noise, fast", "contact"])
def test_circle_is_followed_in_a_world_that_is_not_ideal(changes, others) -> None:
    loop = Along(CIRCLE, settings=replace(SETTINGS, **changes), **others)
    rms, largest, _ = loop.run_to_the_end()
    assert rms < 0.01 and largest < 0.04  # what is asked for with contact and noise: 2 and 11 mm


def test_obstacle_across_the_path_is_stopped_at_until_it_is_gone() -> None:
    wall, free = floor_of([(2.4, 1.0, 2.5, 3.0)]), floor_of([])
    loop = Along(np.add(LINE, (1.0, 2.0)), floor=free)
    loop.run(1.0)
    loop.controller.floor = wall
    loop.run(8.0)
    assert not np.any(loop.speeds[-1]) and not loop.controller.at_goal
    assert least_distance(wall, loop.places[::4]) > RADIUS
    assert loop.places[-1, 0] > 2.4 - RADIUS - 0.1, "as far as it can"
    assert "the path" in loop.given_up and "occupied" in loop.given_up
    loop.controller.floor = free
    assert loop.run_to_the_end()[1] < LARGEST and not loop.given_up


def test_speed_along_a_path_changes_while_it_is_followed() -> None:
    loop = Along(EIGHT)
    for speed in (0.3, 0.5, 0.1):
        loop.controller.change(replace(SETTINGS, path_speed=speed))
        loop.run(1.5)
        loop.keep_from_now_on()
        loop.run(0.5)
        way = np.sum(np.linalg.norm(np.diff(loop.places, axis=0), axis=1))
        assert 0.9 * speed < way / 0.5 < 1.01 * speed


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_strategy_follows_paths_and_holds_the_sphere_at_their_end(strategy) -> None:
    loop = Along(CORNER, settings=replace(SETTINGS, strategy=strategy))
    assert loop.run_to_the_end()[1] < LARGEST
    loop.keep_from_now_on()
    for pushed, duration in ((0.5, 0.3), (-0.5, 8.0)):
        loop.push_momentum(pushed * MOMENTUM)
        loop.run(duration)
    away = np.linalg.norm(loop.places - CORNER[-1], axis=1)
    assert away[-1] < 1e-2 and np.max(away) > 5e-3 and loop.controller.at_goal


@pytest.mark.parametrize("speed", [0.05, 0.0], ids=["slow", "as fast as it can"])
def test_small_robot_follows_a_small_circle(speed) -> None:
    scale = PALM.shell_radius / RADIUS
    settings = replace(SETTINGS, path_speed=speed, path_tolerance=0.02 * scale).of(PALM)
    loop = Along(scale * CIRCLE, settings=settings, robot=PALM, nominal=PALM, spacing=1e-3)
    rms, largest, _ = loop.run_to_the_end()
    assert rms < scale * RMS and largest < scale * LARGEST
