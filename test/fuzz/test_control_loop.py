# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control loop under valid poses, rotor speeds and times that no robot has together."""

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import make_state
from sphere_nmpc.settings import ControllerSettings

STEPS = [1e-9, 1e-6, 1e-3, 0.01, 0.05, 0.25, 1.0, 60.0, 3600.0]
SHARES = [0.02, 0.02, 0.05, 0.4, 0.3, 0.15, 0.03, 0.02, 0.01]
SPEEDS = [1.0, 100.0, 1e4, 1e300, 1e308]
NOISE = {"pose_position_noise": 1e-4, "pose_orientation_noise": 1e-3}


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("noise", [{}, NOISE], ids=["exact", "noisy"])
@pytest.mark.parametrize("seed", range(4))
def test_numbers_that_are_far_from_those_of_a_robot_cause_neither_warning_nor_failure(
    noise, seed
) -> None:
    rng = np.random.default_rng(seed)
    scale = [1e-3, 1.0, 1e3, 1e6][seed]
    controller = Controller(ControllerSettings(strategy="paper", **noise), RobotParameters())
    time, place, turn = 0.0, np.zeros(2), np.array([1.0, 0.0, 0.0, 0.0])
    for i in range(200):
        time += rng.choice(STEPS, p=SHARES)
        if rng.random() < 0.3:
            place = np.clip(scale * rng.normal(size=2), -1e6, 1e6)
        if rng.random() < 0.2:
            turn = rng.normal(size=4)
            turn /= np.linalg.norm(turn)
        state = make_state(place, turn)
        controller.observe(time, state)
        controller.observe_rotors(time, rng.choice(SPEEDS) * rng.uniform(-1.0, 1.0, 2))
        if i % 40 == 0:
            controller.set_goal(make_state(np.clip(scale * rng.normal(size=2), -1e6, 1e6), turn))
        if rng.random() < 0.25:
            controller.commit(controller.decide(time), time)
    assert controller.failures == 0, controller.last_failure
    for _ in range(30):  # The motion of a robot again, which rests after it has been disabled.
        time += 0.1
        controller.enabled = False
        controller.observe(time, state)
        decision = controller.decide(time)
        controller.commit(decision, time)
    np.testing.assert_allclose(decision.state, state, atol=1e-2)
    assert controller.failures == 0, controller.last_failure
