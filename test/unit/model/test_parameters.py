# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Robot parameters: Table 1 of the paper, derived constants, and refused values."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantities

NUMBERS = quantities(RobotParameters)


def test_defaults_are_table_1() -> None:
    robot = RobotParameters()
    assert (robot.shell_mass, robot.shell_radius, robot.shell_inertia) == (1.0, 0.3, 0.06)
    assert (robot.rotor_offset, robot.counterweight_mass, robot.rotor_mass) == (0.15, 0.7, 0.7)
    assert robot.rotor_axial_inertia == robot.counterweight_axial_inertia == 0.008
    assert robot.rotor_transverse_inertia == robot.counterweight_transverse_inertia == 0.004
    assert robot.max_rotor_speed == 100.0


def test_inertias_and_lumped_constants_of_table_1_agree_with_hand_calculation() -> None:
    robot = RobotParameters()
    assert robot.total_mass == pytest.approx(3.8)  # 1 + 2 * 0.7 + 2 * 0.7 kg
    # 0.008 + 0.008 + 2 * (0.004 + 0.7 * 0.0225) + 0.06 kg m^2
    assert robot.transverse_inertia == pytest.approx(0.1155)
    assert robot.axial_inertia == pytest.approx(0.139)  # 4 * (0.004 + 0.01575) + 0.06
    assert robot.rolling_inertia == pytest.approx(0.342)  # 3.8 * 0.09
    lumped = robot.lumped
    np.testing.assert_allclose(
        lumped.as_array(), [0.3, 0.008 / 0.4575, 0.342 / 0.4575, 0.342 / 0.481], rtol=1e-14
    )


@given(
    name=st.sampled_from(sorted(NUMBERS)),
    bad=st.one_of(
        st.sampled_from([math.nan, math.inf, -math.inf, None, "1", True, [1.0]]),
        st.floats(max_value=-1e-12),
    ),
)
def test_what_is_not_a_number_or_negative_is_refused_by_name(name: str, bad: object) -> None:
    with pytest.raises(InvalidParameterError) as caught:
        RobotParameters(**{name: bad})
    message = str(caught.value)
    assert caught.value.name == name
    assert message.startswith(f"{name}: given {bad!r}, expected ")
    assert NUMBERS[name].unit in message
    with pytest.raises(InvalidParameterError, match=name):
        RobotParameters(**{name: 1.001 * NUMBERS[name].maximum})
    with pytest.raises(InvalidParameterError, match=r"rotor_offset.*less than shell_radius"):
        RobotParameters(rotor_offset=0.3)
