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
    assert list(PAPER_CASES) == [1, 2, 3, 4]
    np.testing.assert_allclose(PAPER_CASES[2].start, [1, 2, 0.5, 0.5, 0.5, 0.5])
    half = np.sqrt(0.5)
    for case in (2, 4):
        np.testing.assert_allclose(PAPER_CASES[case].goal, [0, 0, half, 0, half, 0], atol=1e-15)
    for case in (1, 3):
        np.testing.assert_array_equal(PAPER_CASES[case].goal, [0, 0, 1, 0, 0, 0])
    for scenario in PAPER_CASES.values():
        # Normalised, yet all printed digits are still there.
        assert abs(np.linalg.norm(scenario.start[2:6]) - 1.0) < 1e-15
    np.testing.assert_allclose(
        PAPER_CASES[1].start, [2, -3, 0.03, 0.454, 0.88, 0.1363], atol=6e-4
    )
    np.testing.assert_allclose(
        PAPER_CASES[4].start, [0, 0, 0.2734, 0.5628, 0.4281, 0.6521], atol=5e-5
    )


def test_random_scenarios_depend_on_seed_and_index_alone() -> None:
    few, many = draw_scenarios(3, 7), draw_scenarios(10, 7)
    for a, b in zip(few, many, strict=False):
        np.testing.assert_array_equal(a.start, b.start)
        np.testing.assert_array_equal(a.goal, b.goal)
        assert a.seed == b.seed
    other = draw_scenarios(3, 8)
    assert not np.any(other[0].start == few[0].start)


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


def test_every_run_has_a_seed_of_its_own() -> None:
    seeds = [s.seed for s in draw_scenarios(200, 1)]
    assert len(set(seeds)) == 200


def test_far_goals_are_10_to_60_m_away() -> None:
    apart = [np.linalg.norm(s.goal[:2] - s.start[:2]) for s in draw_scenarios(200, 1, "far")]
    assert 10.0 <= min(apart) < 12.0 and 58.0 < max(apart) <= 60.0


def test_circle_draws_have_both_contact_points_on_gamma() -> None:
    for scenario in draw_scenarios(50, 1, "circle"):
        for state in (scenario.start, scenario.goal):
            assert distance_to_circle(state) < 1e-12


def test_half_turns_are_in_place_and_by_pi() -> None:
    for scenario in draw_scenarios(50, 1, "half_turn"):
        np.testing.assert_array_equal(scenario.start[:2], scenario.goal[:2])
        # The scalar part of the turn between them is the cosine of half its angle.
        assert abs(scenario.start[2:] @ scenario.goal[2:]) < 1e-12


def test_upright_goals_are_turned_about_the_vertical_alone() -> None:
    drawn = draw_scenarios(300, 1, "upright")
    assert all(not np.any(scenario.goal[3:5]) for scenario in drawn)
    headings = [2.0 * np.arctan2(s.goal[5], s.goal[2]) for s in drawn]
    assert stats.kstest(headings, stats.uniform(-np.pi, 2.0 * np.pi).cdf).pvalue > 1e-3
    for upright, anywhere in zip(drawn, draw_scenarios(300, 1), strict=True):
        np.testing.assert_array_equal(upright.start, anywhere.start)


def test_typed_goals_have_round_numbers_and_all_starts_and_headings_occur() -> None:
    drawn = draw_scenarios(400, 1, "typed")
    assert len({tuple(s.start) for s in drawn}) == 6
    headings = np.degrees(2.0 * np.arctan2([s.goal[5] for s in drawn], [s.goal[2] for s in drawn]))
    assert set(np.round(headings / 15.0, 9) % 24.0) == set(range(24))
    for scenario in drawn:
        x, y = abs(scenario.goal[:2])
        assert x == y or not x or not y
        assert max(x, y) <= 10.0


def test_the_verb_offers_every_kind() -> None:
    assert tuple(DRAWS) == _KINDS
