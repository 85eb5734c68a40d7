# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A run and what is recorded of it."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import RunRecord
from sphere_sim.study.single_run import followed_inputs, prepare, run_scenario
from sphere_sim.world.disturbances import Push
from sphere_sim.world.plant.rolling_plant import RollingPlant

SCENARIO = draw_scenarios(1, 5)[0]
SHORT = StudyConditions(duration=4.0)

SPEEDS_AGREE = 1e-6
"""Difference by knot times that are rounded to nanoseconds [rad/s]."""

STATES_AGREE = 1e-8
"""Difference by the integration in steps of other lengths [mixed units]."""


PUSHED = replace(SCENARIO, push=Push(1.234567891, (0.3, -0.4)))


@pytest.mark.parametrize("plant", ["rolling", "rigid_body"])
def test_push_acts_at_its_time_to_the_nanosecond(plant) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    conditions = SHORT.with_settings([("plant", plant)])
    trajectories = []
    for scenario in (SCENARIO, PUSHED):
        simulator, controller = prepare(conditions, scenario)
        trajectories.append(
            run_closed_loop(
                simulator, controller, scenario.goal, 2.0, 0.5, push=scenario.push,
            )
        )
    still, pushed = trajectories
    assert not still.at_push.size
    before = pushed.times < 1.234
    # The contact is integrated in other steps up to the push, which is between two samples.
    np.testing.assert_array_equal(pushed.states[before], still.states[before])
    assert np.max(np.abs(pushed.states[-1] - still.states[-1])) > 0.05
    momentum = pushed.at_push[8:]
    np.testing.assert_allclose(momentum, [0.3 * 0.4, 0.3 * 0.3, 0.0], atol=1e-4)
    i = int(np.flatnonzero(before)[-1])
    share = (1.234567891 - pushed.times[i]) / 0.01
    # Linear within 10 ms but for the curvature, below 100 m/s^2 and 1000 1/s^2.
    between = pushed.states[i] + share * (pushed.states[i + 1] - pushed.states[i])
    np.testing.assert_allclose(pushed.at_push[:6], between, atol=0.02)


def test_recorded_inputs_reproduce_speeds_and_states() -> None:
    conditions = SHORT.with_settings([("control_rate", "7.0")])
    simulator, controller = prepare(conditions, SCENARIO)
    period = conditions.controller.control_period
    trajectory = run_closed_loop(simulator, controller, SCENARIO.goal, 4.0, period)
    inputs = followed_inputs(trajectory.holds, 4.0)
    assert (inputs.start, inputs.end) == (0.0, 4.0)
    for i in range(2):
        speeds = np.interp(trajectory.times, inputs.times, inputs.speeds[:, i])
        np.testing.assert_allclose(speeds, trajectory.speeds[:, i], rtol=0, atol=SPEEDS_AGREE)

    plant = RollingPlant(RobotParameters(), SCENARIO.start)
    for duration, end in zip(np.diff(inputs.times), inputs.speeds[1:], strict=True):
        plant.advance(end, float(duration))
    np.testing.assert_allclose(plant.state, trajectory.states[-1], rtol=0, atol=STATES_AGREE)


def test_a_command_replaces_what_is_left_of_the_one_before() -> None:
    first = FirstOrderHold(np.array([0.0, 1.0, 2.0]), np.array([[0, 0], [10, 10], [20, 20]]))
    second = FirstOrderHold(np.array([0.5, 1.5]), np.array([[5, 5], [0, 0]]))
    inputs = followed_inputs([first, second], 1.0)
    np.testing.assert_array_equal(inputs.times, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(inputs.speeds[:, 0], [0.0, 5.0, 2.5])


def test_record_is_read_back_to_the_bit() -> None:
    record = run_scenario(replace(SHORT, duration=2.0), PUSHED)
    assert record.at_push.size == 11
    index, again = RunRecord.from_json(record.as_json(3))
    assert index == 3 and again.results == record.results
    for name in ("times", "speeds", "at_push"):
        np.testing.assert_array_equal(getattr(again, name), getattr(record, name))


def test_run_that_crashes_is_recorded_as_such(monkeypatch) -> None:
    def fail(self: object, end: object, duration: float) -> None:
        raise ArithmeticError("no longer finite")

    monkeypatch.setattr(RollingPlant, "advance", fail)
    record = run_scenario(SHORT, SCENARIO)
    assert record.results["crash"] == "ArithmeticError: no longer finite"
    assert record.results["settled"] is False


def test_controller_has_the_nominal_parameters_of_a_perturbed_robot() -> None:
    simulator, controller = prepare(replace(SHORT, perturbation=3.0), SCENARIO)
    assert simulator.plant._mass != RobotParameters().total_mass
    assert controller.estimator.plant.constants == RobotParameters().lumped


def test_settings_that_depend_on_each_other_are_accepted_in_any_order() -> None:
    small = [("robot.shell_radius", "0.0365"), ("robot.rotor_offset", "0.015")]
    large = [("robot.shell_radius", "1.0"), ("robot.rotor_offset", "0.5")]
    for settings in (small, large):
        there, back = (SHORT.with_settings(order) for order in (settings, settings[::-1]))
        assert there == back
        assert there.robot.rotor_offset == float(settings[1][1])
    with pytest.raises(InvalidParameterError, match="rotor_offset"):
        SHORT.with_settings(small[:1])
