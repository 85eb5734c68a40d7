# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Robots with given constants, and files of parameters."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_sim.identification.robot_file import (
    CHANGED,
    Entry,
    deviations_of,
    with_constants,
    written,
)
from sphere_sim.scenario.perturbation import perturbed

CONFIG = Path(__file__).parents[3] / "config" / "sphere.yaml"


@pytest.mark.parametrize("seed", range(20))
def test_robot_has_the_constants_of_another_and_its_own_masses(seed) -> None:
    given = RobotParameters()
    true = perturbed(given, 0.1, np.random.default_rng(seed))
    found = with_constants(given, true.lumped)
    assert found.lumped.as_array() == pytest.approx(true.lumped.as_array(), rel=1e-9)
    changed = {name for name in vars(given) if getattr(given, name) != getattr(found, name)}
    assert changed == {"shell_radius", *CHANGED}


def test_constants_of_no_robot_are_refused() -> None:
    with pytest.raises(InvalidParameterError):
        with_constants(RobotParameters(), LumpedConstants(0.3, 0.017, 0.99, 0.5))


def test_deviations_are_those_of_drawn_constants() -> None:
    given = RobotParameters()
    constants = given.lumped.as_array()
    spread = np.diag((1e-3 * constants) ** 2)
    told = deviations_of(given, constants, spread)
    rng = np.random.default_rng(1)
    drawn = [
        with_constants(given, LumpedConstants(*(constants * (1.0 + 1e-3 * rng.normal(size=4)))))
        for _ in range(2000)
    ]
    for name, deviation in told.items():
        assert np.std([getattr(one, name) for one in drawn]) == pytest.approx(deviation, rel=0.1)


def test_file_is_yaml_with_numbers_that_are_real() -> None:
    text = written({
        "/**": {"robot.shell_mass": Entry(1.0, "as given"), "robot.shell_inertia": Entry(1e-9)},
        "/**/odometry": {"imu.position": Entry((1.0, 2e-7, -3.5))},
    }, "two\nlines")
    assert text.startswith("# two\n# lines\n")
    assert yaml.safe_load(text) == {
        "/**": {"ros__parameters": {"robot": {"shell_mass": 1.0, "shell_inertia": 1e-9}}},
        "/**/odometry": {"ros__parameters": {"imu": {"position": [1.0, 2e-7, -3.5]}}},
    }
