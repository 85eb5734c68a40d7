# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A plan that is kept while nothing is new: when it is, when it is not, and what is sent of it."""

from collections.abc import Callable

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.link import REACH
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out

ROBOT = RobotParameters()
GOAL = as_state([0, 0, 1, 0, 0, 0])
START = as_state([2.0, -3.0, 0.03, 0.454, 0.88, 0.1363])
PERIOD = 0.02


class Loop:
    """Controller and a plant that is as it was built, at 50 Hz."""

    def __init__(self) -> None:
        self.controller = Controller(ControllerSettings(control_rate=1.0 / PERIOD), ROBOT)
        self.controller.set_goal(GOAL)
        self.state = np.concatenate((START, np.zeros(3)))
        self.time, self.new = 0.0, list[bool]()

    def run(self, count: int) -> None:
        """Advance by a number of sampling instants."""
        for _ in range(count):
            self.controller.observe(self.time, self.state[:6])
            self.decision = self.controller.decide(self.time)
            sent = self.controller.commit(self.decision, self.time)
            assert sent is not None
            self.sent, after = sent, self.time + PERIOD
            times = [self.time, *sent.knots_between(self.time, after), after]
            speeds = np.array([sent.at(time) for time in times])
            self.state = roll_out(
                self.state, speeds, np.diff(times), ROBOT.lumped.as_array()
            )[-1]
            self.time = after
            self.new.append(self.decision.is_new)


def test_plan_is_kept_at_most_instants_and_the_sphere_arrives_and_rests() -> None:
    loop = Loop()
    loop.run(360)
    assert loop.controller.at_goal
    assert np.mean(loop.new) < 0.35  # a prototype solved a third
    assert np.mean(loop.new[-25:]) < 0.2  # at rest as well, once a sample period and a little
    assert loop.controller.failures == 0


@pytest.fixture
def following() -> Loop:
    """A loop whose newest plan has been kept."""
    loop = Loop()
    while not loop.new or loop.new[-1]:
        loop.run(1)
    return loop


def another_goal(loop: Loop) -> None:
    loop.controller.set_goal(Goal(as_state([0.01, 0, 1, 0, 0, 0])))


def floor(loop: Loop) -> None:
    free = np.zeros((400, 400), dtype=bool)
    loop.controller.floor = Floor(Grid(free, 0.05, (-10.0, -10.0, 0.0)), ROBOT.shell_radius, 0.05)


def shift(loop: Loop) -> None:
    loop.state[0] += 1e-4


def another_weight(loop: Loop) -> None:
    settings = ControllerSettings(control_rate=1.0 / PERIOD, planning_effort=20_000)
    loop.controller.change(settings)


def pause(loop: Loop) -> None:
    loop.controller.enabled = False
    loop.run(1)
    loop.controller.enabled = True


@pytest.mark.parametrize("event", [another_goal, floor, shift, another_weight, pause])
def test_what_is_new_leads_to_another_plan(
    following: Loop, event: Callable[[Loop], None]
) -> None:
    plan = following.decision.plan
    event(following)
    following.run(1)
    assert following.decision.is_new
    assert following.decision.plan is not plan


def test_what_is_sent_of_a_plan_that_is_kept_is_its_rest(following: Loop) -> None:
    before, plan = following.sent, following.decision.plan
    following.run(1)
    assert following.decision.plan is plan
    sent = following.sent
    assert sent.start == following.time - PERIOD
    assert before.end == sent.end <= sent.start + REACH + 1.0
    for time in np.linspace(sent.start, sent.end, 50):
        np.testing.assert_allclose(sent.at(float(time)), before.at(float(time)), atol=1e-9)
    slopes = np.abs(np.diff(sent.speeds, axis=0)) / np.diff(sent.times)[:, None]
    # Stamps are whole nanoseconds, the shortest interval is a thousand of them.
    assert np.max(slopes) <= ROBOT.max_rotor_acceleration * (1.0 + 1e-6)


def test_wall_time_of_a_plan_counts_once(following: Loop) -> None:
    assert following.decision.plan.solve_time > 0.0
    assert following.decision.solve_time == 0.0
