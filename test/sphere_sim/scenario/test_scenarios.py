# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's cases and random scenarios."""

import numpy as np
from scipy import stats

from sphere_nmpc.model.controllability import distance_to_circle
from sphere_sim.cli.study import _KINDS
from sphere_sim.scenario.draws import DRAWS
from sphere_sim.scenario.scenarios import PAPER_CASES, draw_scenarios


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
    for a, b in zip(few, many, strict=False):
        np.testing.assert_array_equal([a.start, a.goal], [b.start, b.goal])
        assert a.seed == b.seed
    assert not np.any(other[0].start == few[0].start)
    assert len({scenario.seed for scenario in many}) == 200


def test_positions_and_orientations_are_uniform() -> None:
    drawn = draw_scenarios(2000, 0)
    ends = np.array([s.start for s in drawn] + [s.goal for s in drawn])
    assert np.max(np.abs(ends[:, :2])) <= 3.0
    # Kolmogorov-Smirnov test at a level that one seed in a thousand fails.
    for axis in range(2):
        assert stats.kstest(ends[:, axis], stats.uniform(-3, 6).cdf).pvalue > 1e-3
    # On SO(3) the height of any body axis is uniform in -1 ... 1, and so is that of the contact.
    heights = np.array([np.sin(distance_to_circle(x)) for x in ends])
    assert stats.kstest(heights, stats.uniform(0, 1).cdf).pvalue > 1e-3
    np.testing.assert_allclose(np.mean(ends[:, 2:] ** 2, axis=0), 0.25, atol=0.02)


def test_each_kind_is_as_it_says() -> None:
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
    assert stats.kstest(headings, stats.uniform(-np.pi, 2.0 * np.pi).cdf).pvalue > 1e-3
    drawn = draw_scenarios(400, 1, "typed")
    assert len({tuple(s.start) for s in drawn}) == 6
    headings = np.degrees(2.0 * np.arctan2([s.goal[5] for s in drawn], [s.goal[2] for s in drawn]))
    assert set(np.round(headings / 15.0, 9) % 24.0) == set(range(24))
    for scenario in drawn:
        x, y = abs(scenario.goal[:2])
        assert (x == y or not x or not y) and max(x, y) <= 10.0


def test_the_verb_offers_every_kind() -> None:
    assert tuple(DRAWS) == _KINDS
