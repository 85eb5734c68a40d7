# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller, its messages as ros2_control follows them, and the exported model in MuJoCo."""

import numpy as np
import pytest
from ros2_control import Exported, Interpolation

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state, state_error
from sphere_nmpc.ros import cdr_messages
from sphere_nmpc.settings import ControllerSettings

pytestmark = pytest.mark.slow

ORIGIN = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
LATE = 0.004
"""Time that a message takes [s]: two periods of the controller manager."""


@pytest.mark.parametrize("start", [
    make_state((2.0, -3.0), (0.6, 0.8, 0.0, 0.0)), make_state((0.5, 0.2), (0.0, 0.6, 0.0, 0.8)),
])
def test_sphere_settles_at_its_goal(start: Vector) -> None:
    plant, settings = Exported(RobotParameters()), ControllerSettings()
    plant.data.qpos[POSITION], plant.data.qpos[3:7] = start[POSITION], start[QUATERNION]
    plant.mujoco.mj_forward(plant.model, plant.data)
    controller = Controller(settings, RobotParameters())
    controller.set_goal(ORIGIN)
    step = plant.model.opt.timestep  # that of the controller manager too
    hold: FirstOrderHold | None = None
    angles, speeds, followed = np.zeros(2), np.zeros(2), None
    errors, sent = [], []
    for k in range(round(10.0 / step)):
        time = k * step
        errors.append(state_error(plant.state, ORIGIN))
        if k % round(0.01 / step) == 0:
            controller.observe(time, plant.state)
        if k % round(settings.control_period / step) == 0:
            new = controller.commit(controller.decide(time), time)
            if new is not None:
                angles = angles if hold is None else angles + hold.turned(new.start)
                hold = new
                sent.append((time + LATE, cdr_messages.trajectory_message(hold, angles)))
        if sent and sent[0][0] <= time + 1e-9:
            followed = Interpolation(sent.pop(0)[1])
        if followed is not None:
            # The command is the velocity one period ahead.
            _, speeds = followed.sample(time + step)
        plant.step(speeds)
    assert max(errors[:10]) > 0.5, "far from the goal"
    assert max(errors[-round(2.0 / step):]) < 0.01
