# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random pushes, slopes and centres of mass."""

from dataclasses import replace

import numpy as np
from scipy import stats

from sphere_sim.scenario.disturbance_draws import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.world.push import Push

MANY = draw_scenarios(400, 3, "upright")
RANGE = DisturbanceDraws(push=(0.5, 1.0))


def drawn(draws: DisturbanceDraws) -> list[Scenario]:
    return [draws.applied_to(scenario) for scenario in MANY]


def pushes(draws: DisturbanceDraws) -> list[Push]:
    return [s.push for s in drawn(draws) if s.push is not None]


def is_uniform(values: list[float], low: float, high: float) -> bool:
    # Kolmogorov-Smirnov test at a level that one seed in a thousand fails.
    return bool(stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > 1e-3)


def test_pushes_are_uniform_in_impulse_direction_and_time() -> None:
    found = pushes(RANGE)
    assert len(found) == len(MANY)
    assert is_uniform([float(np.hypot(*push.impulse)) for push in found], 0.5, 1.0)
    assert is_uniform([np.arctan2(*push.impulse) for push in found], -np.pi, np.pi)
    assert is_uniform([push.time for push in found], 0.5, 3.0)


def test_time_of_a_push_may_be_given_and_changes_nothing_else() -> None:
    timed = pushes(replace(RANGE, push_time=7.0))
    assert {push.time for push in timed} == {7.0}
    assert [push.impulse for push in timed] == [push.impulse for push in pushes(RANGE)]


def test_slope_has_its_inclination_and_any_direction() -> None:
    found = [s.disturbances for s in drawn(DisturbanceDraws(slope=0.01))]
    assert {values["slope"] for values in found} == {0.01}
    assert is_uniform([values["slope_direction"] for values in found], -np.pi, np.pi)


def test_centre_of_mass_has_its_distance_and_any_direction() -> None:
    names = ("mass_offset_x", "mass_offset_y", "mass_offset_z")
    scenarios = drawn(DisturbanceDraws(offset=2e-3))
    found = np.array([[s.disturbances[name] for name in names] for s in scenarios])
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 2e-3)
    for axis in range(3):
        assert is_uniform(list(found[:, axis]), -2e-3, 2e-3)


def test_each_draw_is_the_same_whatever_else_is_drawn() -> None:
    everything = drawn(replace(RANGE, slope=0.01, offset=2e-3))
    alone = zip(drawn(RANGE), drawn(DisturbanceDraws(slope=0.01)), strict=True)
    for together, (pushed, tilted) in zip(everything, alone, strict=True):
        assert together.push == pushed.push
        assert tilted.disturbances.items() <= together.disturbances.items()


def test_without_draws_a_scenario_keeps_what_it_has() -> None:
    own = replace(MANY[0], push=Push(1.0, (0.1, 0.2)), disturbances={"slope": 0.02})
    kept = DisturbanceDraws().applied_to(own)
    assert (kept.push, kept.disturbances) == (own.push, own.disturbances)
