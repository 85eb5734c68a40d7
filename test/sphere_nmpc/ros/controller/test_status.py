# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status values of the controller: plant parameters and drift."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Mode
from sphere_nmpc.model.drift import (
    NO_DRIFT,
    Drift,
    imbalance_of_offset,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.controller import reports
from sphere_nmpc.ros.controller.drift_values import drift_values
from sphere_nmpc.ros.controller.status import ControllerStatus
from sphere_nmpc.settings import STRATEGIES, ControllerSettings

ROOT = Path(__file__).parents[4]
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


def test_delay_and_loss_of_commands_are_reported() -> None:
    chosen = ControllerSettings()
    controller = Controller(chosen, ROBOT)
    feedback = controller.rotor_feedback
    feedback.window, feedback.delay, feedback.loss = 0.05, 0.04, 0.1
    values = ControllerStatus(controller, ROBOT, chosen).values(
        controller.decide(0.0), 0.0, 0.0, 0
    )
    names = ("commitment_window_s", "command_delay_s", "command_loss")
    assert [values[name] for name in names] == [0.05, 0.04, 0.1]


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


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_value_is_documented(strategy) -> None:
    table = (ROOT / "msg_docs" / "topics.md").read_text().split("### Status")[1].split("\n### ")[0]
    cells = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    documented = {key for cell in cells for key in re.findall(r"`(\w+)`", cell)}
    settings = ControllerSettings(strategy=strategy)
    controller = Controller(settings, ROBOT)
    status = ControllerStatus(controller, ROBOT, settings)
    values = status.values(controller.decide(0.0), 0.0, 0.0, 0)
    # The deviations are described with what they belong to.
    assert {key.removesuffix("_deviation") for key in values} <= documented
    assert values["giving_up"] == "" and values["momentum_x"] == 0.0


def test_every_mode_has_a_level() -> None:
    assert set(reports._LEVELS) == set(Mode)


def test_no_drift_gives_zeros_and_no_saturation() -> None:
    values = drift_values(NO_DRIFT, ROBOT, make_state((1.0, 2.0), (0.5, 0.5, 0.5, 0.5)))
    assert values.pop("saturation_s") == math.inf
    assert set(values.values()) == {0.0}
    assert not any(math.copysign(1.0, value) < 0.0 for value in values.values()), "-0 in the text"


@pytest.mark.parametrize("direction", [0.0, 2.0, -2.0, math.pi])
def test_drift_is_reported_in_the_units_of_its_causes(direction) -> None:
    offset = np.array([0.5, -1.0, 2.0])
    impulse = 0.5 * np.array([math.cos(direction), math.sin(direction)])
    drift = Drift(
        momentum_of_push(ROBOT, impulse),
        slope_torque(ROBOT, math.radians(0.3), direction),
        imbalance_of_offset(ROBOT, 1e-3 * offset),
    )
    values = drift_values(drift, ROBOT, None)
    names = "slope_deg", "slope_direction_deg", *(f"mass_offset_{axis}_mm" for axis in "xyz")
    expected = [0.3, math.degrees(direction), *offset]
    assert [values[name] for name in names] == pytest.approx(expected, rel=1e-9)
    # An impulse at the height of the centre, Rs e3 x J [N m s].
    momentum = [-0.3 * impulse[1], 0.3 * impulse[0], 0.0]
    assert [values[f"momentum_{axis}"] for axis in "xyz"] == pytest.approx(momentum, abs=1e-15)
    assert all(math.isnan(values[name]) for name in ("rest_speed_1", "rest_speed_2"))
    assert math.isnan(values["saturation_s"]), "known for a goal only"


def test_speeds_and_saturation_are_those_of_a_rest_at_the_goal() -> None:
    """A heading of 90 degrees: momentum about the world's y axis is held by rotor 1."""
    goal = make_state((0.0, 0.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    drift = Drift(momentum=np.array([0.0, 40.0, 0.0]), slope=np.array([0.0, 10.0]))
    values = drift_values(drift, ROBOT, goal)
    assert values["rest_speed_1"] == pytest.approx(40.0)
    assert values["rest_speed_2"] == pytest.approx(0.0, abs=1e-12)
    assert values["saturation_s"] == pytest.approx(6.0)
