# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller over a link that delays and loses messages, in simulated time."""

from typing import Any

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.disturbance import is_zero
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import make_state, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
GOAL = make_state((0.9, -1.1), random_quaternion(np.random.default_rng(1)))
STEP, SPACING, PERIOD = 10_000_000, 0.02, 0.25
"""Spacing of the instants [ns], of poses and copies of commands, and of plans [s]."""
LARGEST_NOISE = 1e-3
"""Residual of predictions [m, -]: up to 5e-4 with measured rotor speeds, up to 1.5e-2 without."""


class Wire:
    """One topic over the link; what was overtaken is dropped."""

    def __init__(self, seed: int, delay: float, loss: float, bursts: tuple[float, ...]) -> None:
        self._random = np.random.default_rng(seed)
        self._delay, self._loss, self._bursts = delay, loss, bursts
        self._pending: list[tuple[float, Any]] = []

    def send(self, now: float, message: Any) -> None:
        """Lose a message, or deliver it after the delay of half as much or half as much again."""
        lost = self._random.random() < self._loss
        if not lost and not any(start <= now < start + 2.0 for start in self._bursts):
            due = now + self._delay * self._random.uniform(0.5, 1.5)
            self._pending.append((due, message))

    def receive(self, now: float) -> list[Any]:
        """Return the newest message that is due, if there is one."""
        due = [i for i, (time, _) in enumerate(self._pending) if time <= now]
        if not due:
            return []
        message = self._pending[due[-1]][1]
        del self._pending[: due[-1] + 1]
        return [message]


class LinkedLoop:
    """Simulator and controller with a link in between, whose clock may be late, too [s]."""

    def __init__(
        self, delay: float = 0.02, loss: float = 0.0, bursts: tuple[float, ...] = (),
        clock_delay: float = 0.0, joint_states: bool = True,
    ) -> None:
        self.simulator = Simulator(SimulatorSettings(pose_rate=1.0 / SPACING), ROBOT)
        self.controller = Controller(ControllerSettings(), ROBOT)
        self.clock_delay, self.joint_states = clock_delay, joint_states
        self.poses, self.joints, self.commands = (
            Wire(seed, delay, loss, bursts) for seed in range(3)
        )
        self._copies: list[tuple[float, FirstOrderHold]] = []

    def go(self, goal: np.ndarray) -> float:
        """Return the time to a goal, shape (6,), at which the sphere stays for a second [s]."""
        began = inside = self.simulator.time
        self.controller.set_goal(goal)
        while self.simulator.time < inside + 1.0:
            self.step()
            if state_error(self.simulator.plant.state, goal) >= 1e-2:
                inside = self.simulator.time
            assert self.simulator.time < began + 60.0, "not reached"
        return inside - began

    def step(self) -> None:
        """Advance by one instant."""
        simulator, controller = self.simulator, self.controller
        simulator.advance_to(simulator.now + STEP)
        true, count = simulator.time, simulator.now // STEP
        now = true - self.clock_delay
        if count % round(SPACING * 1e9 / STEP) == 0:
            self.poses.send(true, (true, simulator.plant.state.copy()))
            self.joints.send(true, (true, simulator.plant.rotor_speeds.copy()))
        for hold in self.commands.receive(true):
            simulator.follower.follow_trajectory(hold)
        for time, speeds in self.joints.receive(true) if self.joint_states else ():
            controller.observe_rotors(time, speeds)
        for time, state in self.poses.receive(true):
            controller.rotor_feedback.poses.received(time, now - time)
            controller.observe(time, state)
        while self._copies and self._copies[0][0] <= true:
            self.commands.send(true, self._copies.pop(0)[1])
        if count % round(PERIOD * 1e9 / STEP) == 0:
            decision = controller.decide(now + controller.rotor_feedback.window)
            sent = controller.commit(decision, now)
            if sent is not None:
                self.commands.send(true, sent)
                again = (1, 2) if controller.rotor_feedback.shows_link else ()
                self._copies = [(true + i * SPACING, sent) for i in again]


def test_without_a_link_nothing_is_committed_ahead() -> None:
    loop = LinkedLoop(delay=0.0)
    loop.go(GOAL)
    feedback = loop.controller.rotor_feedback
    assert feedback.window == feedback.loss == 0.0 and not feedback.shows_link


@pytest.mark.parametrize(
    ("loss", "bursts", "clock_delay"),
    # A burst early on, while the plan still changes: later commands repeat those that were lost.
    [(0.2, (), 0.02), (0.05, (0.5, 10.0, 18.0), 0.0)], ids=["lost", "bursts"],
)
def test_lost_commands_are_no_other_plant_and_cost_little_time(
    loss: float, bursts: tuple[float, ...], clock_delay: float
) -> None:
    loop = LinkedLoop(loss=loss, bursts=bursts, clock_delay=clock_delay)
    took = loop.go(GOAL)
    estimator = loop.controller.estimator
    built = ROBOT.lumped.as_array()
    # Over six goals within 20 mm the worst was 6.4e-4.
    np.testing.assert_allclose(estimator.plant.constants.as_array(), built, rtol=2e-3)
    assert estimator.plant.noise < LARGEST_NOISE
    assert is_zero(estimator.momentum, estimator.disturbance)
    assert 0.02 < loop.controller.rotor_feedback.window < 0.3
    # Without a link 4.0 s.
    assert took < 6.0


def test_goal_is_reached_without_joint_states() -> None:
    """Commands are then expected to be lost as often as poses."""
    loop = LinkedLoop(loss=0.05, joint_states=False)
    took = loop.go(GOAL)
    feedback = loop.controller.rotor_feedback
    assert 0.015 < feedback.window < 0.03 and 0.02 < feedback.loss < 0.1
    # Over twelve goals within 0.8 m from 4.0 to 4.4 s; without the window up to 26 s, or never.
    assert took < 6.0
