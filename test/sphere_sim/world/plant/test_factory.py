# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plants by name, also without MuJoCo."""

import subprocess
import sys

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import PLANTS, SimulatorSettings
from sphere_sim.world.simulator import Simulator

ORIGIN = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def test_every_name_makes_a_plant():
    pytest.importorskip("mujoco")
    for name in PLANTS:
        np.testing.assert_array_equal(make_plant(name, RobotParameters(), ORIGIN).state, ORIGIN)


def test_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(InvalidParameterError, match="rolling or rigid_body"):
        make_plant("flying", RobotParameters(), ORIGIN)


def test_missing_mujoco_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert isinstance(make_plant("rolling", RobotParameters(), ORIGIN), RollingPlant)
    with pytest.raises(ImportError, match=r"sphere_nmpc\[rigid\]"):
        make_plant("rigid_body", RobotParameters(), ORIGIN)


def test_simulator_does_not_load_mujoco_for_the_rolling_plant():
    code = "import sys, sphere_sim.world.simulator; sys.exit('mujoco' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_simulator_runs_the_named_plant_up_to_its_reference():
    pytest.importorskip("mujoco")
    simulator = Simulator(SimulatorSettings(plant="rigid_body"), RobotParameters())
    simulator.follower.follow_speeds(np.array([40.0, -20.0]), 0.0)
    simulator.advance_to(400_000_000)
    # The lag of the servos must not slow the reference down.
    np.testing.assert_allclose(simulator.speed_reference, [40.0, -20.0])
    np.testing.assert_allclose(simulator.plant.rotor_speeds, [40.0, -20.0], atol=0.1)
    simulator.reset()
    np.testing.assert_array_equal(simulator.speed_reference, 0.0)
