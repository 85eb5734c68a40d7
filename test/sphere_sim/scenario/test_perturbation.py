# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random errors of the robot's parameters, pushes, slopes and centres of mass."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy import stats

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.scenario.perturbation import LIMITS, DisturbanceDraws, perturbed
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.world.disturbances import Push

ROBOT = RobotParameters()
MANY = draw_scenarios(400, 3, "upright")
RANGE = DisturbanceDraws(push=(0.5, 1.0))


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


def test_fraction_of_zero_is_the_same_robot_and_one_out_of_range_is_refused() -> None:
    assert perturbed(ROBOT, 0.0, np.random.default_rng(0)) is ROBOT
    for fraction in (-0.1, 1.0, float("nan")):
        with pytest.raises(InvalidParameterError):
            perturbed(ROBOT, fraction, np.random.default_rng(0))


def drawn(draws: DisturbanceDraws) -> list[Scenario]:
    return [draws.applied_to(scenario) for scenario in MANY]


def is_uniform(values: list[float], low: float, high: float) -> bool:
    # Kolmogorov-Smirnov test at a level that one seed in a thousand fails.
    return bool(stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > 1e-3)


def test_pushes_are_uniform_in_impulse_direction_and_time_which_may_be_given() -> None:
    found = [scenario.push for scenario in drawn(RANGE)]
    assert is_uniform([float(np.hypot(*push.impulse)) for push in found], 0.5, 1.0)
    assert is_uniform([np.arctan2(*push.impulse) for push in found], -np.pi, np.pi)
    assert is_uniform([push.time for push in found], 0.5, 3.0)
    timed = [scenario.push for scenario in drawn(replace(RANGE, push_time=7.0))]
    assert timed == [Push(7.0, push.impulse) for push in found]


def test_slope_and_centre_of_mass_have_their_size_and_any_direction() -> None:
    found = [s.disturbances for s in drawn(DisturbanceDraws(slope=0.01, offset=2e-3))]
    assert {values["slope"] for values in found} == {0.01}
    assert is_uniform([values["slope_direction"] for values in found], -np.pi, np.pi)
    offsets = np.array([[values[f"mass_offset_{axis}"] for axis in "xyz"] for values in found])
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), 2e-3)
    for axis in range(3):
        assert is_uniform(list(offsets[:, axis]), -2e-3, 2e-3)


def test_each_draw_is_the_same_whatever_else_is_drawn() -> None:
    everything = drawn(replace(RANGE, slope=0.01, offset=2e-3))
    alone = zip(drawn(RANGE), drawn(DisturbanceDraws(slope=0.01)), strict=True)
    for together, (pushed, tilted) in zip(everything, alone, strict=True):
        assert together.push == pushed.push
        assert tilted.disturbances.items() <= together.disturbances.items()
    own = replace(MANY[0], push=Push(1.0, (0.1, 0.2)), disturbances={"slope": 0.02})
    kept = DisturbanceDraws().applied_to(own)
    assert (kept.push, kept.disturbances) == (own.push, own.disturbances)
