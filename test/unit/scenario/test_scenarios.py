# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's cases, random scenarios, errors of the robot's parameters, and disturbances."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy import stats

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.controllability import distance_to_circle
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.cli.study import _KINDS
from sphere_sim.scenario.perturbation import LIMITS, DisturbanceDraws, perturbed
from sphere_sim.scenario.scenarios import DRAWS, PAPER_CASES, Scenario, draw_scenarios
from sphere_sim.world.disturbances import Push

ROBOT = RobotParameters()
MANY = draw_scenarios(400, 3, "upright")
RANGE = DisturbanceDraws(push=(0.5, 1.0))


def disturbed(draws: DisturbanceDraws) -> list[Scenario]:
    return [draws.applied_to(scenario) for scenario in MANY]


def is_uniform(values: list[float], low: float, high: float) -> bool:
    # Kolmogorov-Smirnov test at a level that one seed in a thousand fails.
    return bool(stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > 1e-3)


def test_cases_are_those_of_section_4() -> None:
    half = np.sqrt(0.5)
    on_circle, origin = [0, 0, half, 0, half, 0], [0, 0, 1, 0, 0, 0]
    starts = {
        1: [2, -3, 0.03, 0.454, 0.88, 0.1363], 2: [1, 2, 0.5, 0.5, 0.5, 0.5],
        3: [0, 0, 0.6521, 0.1132, 0.1115, 0.7413], 4: [0, 0, 0.2734, 0.5628, 0.4281, 0.6521],
    }
    assert list(PAPER_CASES) == [1, 2, 3, 4]
    for case, scenario in PAPER_CASES.items():
        np.testing.assert_allclose(scenario.goal, origin if case % 2 else on_circle, atol=1e-15)
        # Normalised, yet all printed digits are still there.
        np.testing.assert_allclose(scenario.start, starts[case], atol=6e-4)
        assert abs(np.linalg.norm(scenario.start[2:6]) - 1.0) < 1e-15


def test_random_scenarios_depend_on_seed_and_index_alone() -> None:
    few, many, other = draw_scenarios(3, 7), draw_scenarios(200, 7), draw_scenarios(3, 8)
    np.testing.assert_equal([asdict(it) for it in few], [asdict(it) for it in many[:3]])
    assert not np.any(other[0].start == few[0].start)
    assert len({scenario.seed for scenario in many}) == 200


def test_positions_and_orientations_are_uniform() -> None:
    drawn = draw_scenarios(2000, 0)
    ends = np.array([s.start for s in drawn] + [s.goal for s in drawn])
    assert np.max(np.abs(ends[:, :2])) <= 3.0
    for axis in range(2):
        assert is_uniform(ends[:, axis], -3, 3)
    # On SO(3) the height of any body axis is uniform in -1 ... 1, and so is that of the contact.
    heights = np.array([np.sin(distance_to_circle(x)) for x in ends])
    assert is_uniform(heights, 0, 1)
    np.testing.assert_allclose(np.mean(ends[:, 2:] ** 2, axis=0), 0.25, atol=0.02)


def test_each_kind_is_as_it_says_and_offered_by_the_verb() -> None:
    assert tuple(DRAWS) == _KINDS
    for kind, low, high in (("far", 10.0, 60.0), ("kilometre", 1000.0, 1000.0)):
        apart = [np.linalg.norm(s.goal[:2] - s.start[:2]) for s in draw_scenarios(200, 1, kind)]
        assert low <= min(apart) + 1e-9 < low + 2.0 and high - 2.0 < max(apart) <= high + 1e-9
    for scenario in draw_scenarios(50, 1, "circle"):
        assert max(distance_to_circle(x) for x in (scenario.start, scenario.goal)) < 1e-12
    for scenario in draw_scenarios(50, 1, "half_turn"):
        np.testing.assert_array_equal(scenario.start[:2], scenario.goal[:2])
        # The scalar part of the turn between them is the cosine of half its angle.
        assert abs(scenario.start[2:] @ scenario.goal[2:]) < 1e-12
    drawn = draw_scenarios(300, 1, "upright")
    assert all(not np.any(scenario.goal[3:5]) for scenario in drawn)
    headings = [2.0 * np.arctan2(s.goal[5], s.goal[2]) for s in drawn]
    assert is_uniform(headings, -np.pi, np.pi)
    for scenario in draw_scenarios(50, 1, "typed"):
        x, y = abs(scenario.goal[:2])
        assert (x == y or not x or not y) and max(x, y) <= 10.0


def test_every_physical_parameter_varies_within_its_range_and_limits_stay() -> None:
    def draw(seed: int) -> dict[str, float]:
        return asdict(perturbed(ROBOT, 0.2, np.random.default_rng(seed)))

    robots = [draw(seed) for seed in range(300)]
    assert draw(1) == robots[1] != robots[2]
    for name, nominal in asdict(ROBOT).items():
        drawn = np.array([robot[name] for robot in robots])
        if name in LIMITS:
            assert np.all(drawn == nominal)
        else:
            ratios = drawn / nominal
            assert np.all(np.abs(ratios - 1.0) <= 0.2 + 1e-12)
            assert ratios.min() < 0.85 and ratios.max() > 1.15
    assert perturbed(ROBOT, 0.0, np.random.default_rng(0)) is ROBOT
    for fraction in (-0.1, 1.0, float("nan")):
        with pytest.raises(InvalidParameterError):
            perturbed(ROBOT, fraction, np.random.default_rng(0))


def test_pushes_are_uniform_in_impulse_direction_and_time_which_may_be_given() -> None:
    found = [scenario.push for scenario in disturbed(RANGE)]
    assert is_uniform([float(np.hypot(*push.impulse)) for push in found], 0.5, 1.0)
    assert is_uniform([np.arctan2(*push.impulse) for push in found], -np.pi, np.pi)
    assert is_uniform([push.time for push in found], 0.5, 3.0)
    timed = [scenario.push for scenario in disturbed(replace(RANGE, push_time=7.0))]
    assert timed == [Push(7.0, push.impulse) for push in found]


def test_each_draw_is_the_same_whatever_else_is_drawn() -> None:
    everything = disturbed(replace(RANGE, slope=0.01, offset=2e-3))
    alone = zip(disturbed(RANGE), disturbed(DisturbanceDraws(slope=0.01)), strict=True)
    for together, (pushed, tilted) in zip(everything, alone, strict=True):
        assert together.push == pushed.push
        assert tilted.disturbances.items() <= together.disturbances.items()
    own = replace(MANY[0], push=Push(1.0, (0.1, 0.2)), disturbances={"slope": 0.02})
    kept = DisturbanceDraws().applied_to(own)
    assert (kept.push, kept.disturbances) == (own.push, own.disturbances)
