# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Eq. (12) of the paper, as printed and with one sign changed, against the plant with contact."""

import numpy as np
import pytest
from printed_model import PrintedModel

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import angle_error, position_error
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytest.importorskip("mujoco")
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

ROBOT = RobotParameters()
IDEAL_DRIVES = RigidBodySettings(drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3)


def ends(seed):
    """Return the states after 2 s: contact, rolling plant, corrected and printed equations."""
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=4)
    start = np.concatenate(([0.0, 0.0], turn / np.linalg.norm(turn)))
    models = [
        RigidBodyPlant(ROBOT, start, IDEAL_DRIVES),
        RollingPlant(ROBOT, start),
        PrintedModel(ROBOT, start, corrected=True),
        PrintedModel(ROBOT, start, corrected=False),
    ]
    for speeds in rng.uniform(-100.0, 100.0, (4, 2)):
        for model in models:
            model.advance(speeds, 0.5)
    return [model.state for model in models]


@pytest.mark.parametrize("seed", range(5))
def test_one_sign_separates_the_printed_equations_from_the_motion(seed):
    contact, rolling, corrected, printed = ends(seed)
    np.testing.assert_allclose(corrected, rolling, atol=1e-5)
    assert angle_error(corrected, contact) < 5e-3
    assert position_error(corrected, contact) < 1e-3
    assert angle_error(printed, contact) > 0.1
    assert position_error(printed, contact) > 0.02
