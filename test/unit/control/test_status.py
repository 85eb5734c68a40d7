# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status values of the controller: plant parameters and momentum."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.status import ControllerStatus, momentum_values
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.course import Leg
from sphere_nmpc.model.disturbance import (
    Disturbance,
    imbalance_of_offset,
    momentum_of_push,
    slope_torque,
)
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import STRATEGIES, ControllerSettings

ROOT = Path(__file__).parents[3]
ROBOT = RobotParameters()
CONSTANTS = ["learnt_shell_radius_m", "learnt_c1", "learnt_r1", "learnt_r3"]
FLOOR = Floor(Grid(np.zeros((40, 40), dtype=bool), 0.1), 0.3, 0.02)


def arriving(time: float) -> dict[str, Any]:
    """Return what is changed of a plan that arrives at a time [s]."""
    return {"leg": Leg(Goal(upright_state(0.0, 0.0, 0.0), since=time))}


def status_values(
    floor: Floor | None = None, plan: Mapping[str, Any] = {}, **settings: Any
) -> dict[str, Any]:
    """Return the values at 2 s with a plan that is changed."""
    chosen = ControllerSettings(**settings)
    controller = Controller(chosen, ROBOT)
    controller.floor = floor
    decided = controller.decide(2.0)
    conditions = Kind.TRACKING.conditions if plan else decided.conditions
    decision = replace(decided, conditions=conditions, plan=replace(decided.plan, **plan))
    return ControllerStatus(controller, ROBOT, chosen).values(decision, 2.0, 0.0, 0)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_learnt_constants_have_deviations(noise) -> None:
    found = status_values(pose_position_noise=noise)
    assert found["learnt_c1"] == ROBOT.lumped.input_gain
    names = {*(f"{name}_deviation" for name in CONSTANTS), "learnt_noise"}
    assert names <= found.keys()
    fixed = status_values(learning=False, drive_lag=0.0123, pose_position_noise=noise)
    assert [fixed[name] for name in CONSTANTS] == ROBOT.lumped.as_array().tolist()
    assert fixed["learnt_lag_s"] == 0.0123


@pytest.mark.parametrize(
    ("floor", "plan", "name", "told"),
    [
        (None, {}, "clearance_m", None),
        (FLOOR, {}, "clearance_m", math.nan),
        (FLOOR, {"clearance": 0.125}, "clearance_m", 0.125),
        (None, arriving(3.5), "time_left_s", 1.5),
        (None, arriving(1.5), "time_left_s", 0.0),
        (None, arriving(math.nan), "time_left_s", math.nan),
    ],
)
def test_clearance_is_told_on_a_floor_and_time_left_until_an_arrival(
    floor, plan, name, told
) -> None:
    assert status_values(floor, plan).get(name) == pytest.approx(told, nan_ok=True)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_value_is_documented(strategy) -> None:
    table = (ROOT / "msg_docs" / "topics.md").read_text().split("### Status")[1].split("\n### ")[0]
    cells = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    documented = {key for cell in cells for key in re.findall(r"`(\w+)`", cell)}
    values = status_values(FLOOR, strategy=strategy)
    # The deviations are described with what they belong to.
    assert {key.removesuffix("_deviation") for key in values} <= documented
    assert values["giving_up"] == "" and values["momentum_x"] == 0.0


@pytest.mark.parametrize("direction", [0.0, -2.0])
def test_momentum_is_reported_in_the_units_of_its_causes(direction) -> None:
    offset = np.array([0.5, -1.0, 2.0])
    impulse = 0.5 * np.array([math.cos(direction), math.sin(direction)])
    disturbance = Disturbance(
        slope_torque(ROBOT, math.radians(0.3), direction),
        imbalance_of_offset(ROBOT, 1e-3 * offset),
    )
    values = momentum_values(momentum_of_push(ROBOT, impulse), disturbance, ROBOT, None)
    names = "slope_deg", "slope_direction_deg", *(f"mass_offset_{axis}_mm" for axis in "xyz")
    expected = [0.3, math.degrees(direction), *offset]
    assert [values[name] for name in names] == pytest.approx(expected, rel=1e-9)
    # An impulse at the height of the centre, Rs e3 x J [N m s].
    momentum = [-0.3 * impulse[1], 0.3 * impulse[0], 0.0]
    assert [values[f"momentum_{axis}"] for axis in "xyz"] == pytest.approx(momentum, abs=1e-15)
    assert all(math.isnan(values[name]) for name in ("rest_speed_1", "rest_speed_2"))
    assert math.isnan(values["saturation_s"]), "known for a goal only"
