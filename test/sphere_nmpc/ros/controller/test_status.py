# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status values of the controller: plant parameters with and without a state estimator."""

from typing import Any

import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.controller.status import ControllerStatus
from sphere_nmpc.settings import ControllerSettings

ROBOT = RobotParameters()
CONSTANTS = ["learnt_shell_radius_m", "learnt_c1", "learnt_r1", "learnt_r3"]
DEVIATIONS = [f"{name}_deviation" for name in CONSTANTS]


def plant_values(**settings: Any) -> dict[str, Any]:
    chosen = ControllerSettings(**settings)
    controller = Controller(chosen, ROBOT)
    status = ControllerStatus(controller, ROBOT, chosen)
    values = status.values(controller.decide(0.0), 0.0, 0.0, 0)
    return {name: value for name, value in values.items() if name.startswith("learnt_")}


def test_exact_poses_give_constants_with_deviations_noise_and_lag() -> None:
    values = plant_values()
    assert list(values) == [*CONSTANTS, *DEVIATIONS, "learnt_noise", "learnt_lag_s"]
    assert values["learnt_c1"] == ROBOT.lumped.input_gain
    assert values["learnt_c1_deviation"] == pytest.approx(0.1 * ROBOT.lumped.input_gain)


def test_noisy_poses_give_constants_and_lag_alone() -> None:
    values = plant_values(pose_position_noise=0.01)
    assert list(values) == [*CONSTANTS, "learnt_lag_s"]


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_without_learning_the_constants_as_built_and_the_given_lag_are_reported(
    noise: float,
) -> None:
    values = plant_values(learning=False, drive_lag=0.0123, pose_position_noise=noise)
    assert [values[name] for name in CONSTANTS] == ROBOT.lumped.as_array().tolist()
    assert values["learnt_lag_s"] == 0.0123
