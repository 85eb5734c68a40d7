# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops without ROS: the paper's cases, late and noisy poses, weak drives."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, state_error
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import (
    angle_errors,
    position_errors,
    state_errors,
    stay_below,
)
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

pytestmark = pytest.mark.slow

ROBOT = RobotParameters()
PAPER = ControllerSettings(strategy="paper")


def run(
    case: int,
    duration: float,
    settings: ControllerSettings = PAPER,
    controller: Controller | None = None,
    robot: RobotParameters = ROBOT,
    latency: float = 0.0,
    **world: Any,
) -> Trajectory:
    scenario = PAPER_CASES[case]
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(scenario.start), **world), robot
    )
    return run_closed_loop(
        simulator, Controller(settings, ROBOT) if controller is None else controller,
        scenario.goal, duration, settings.control_period, 0.05, latency,
    )


def errors(case: int, trajectory: Trajectory) -> np.ndarray:
    return state_errors(trajectory.states, PAPER_CASES[case].goal)


def settling_time(case: int, trajectory: Trajectory) -> float:
    stay = stay_below(trajectory.times, errors(case, trajectory))
    return float("inf") if stay is None else stay.since


def limits_are_kept(trajectory: Trajectory) -> None:
    assert np.max(np.abs(trajectory.speeds)) <= ROBOT.max_rotor_speed
    for hold in trajectory.holds:
        slopes = np.abs(np.diff(hold.speeds, axis=0)) / np.diff(hold.times)[:, None]
        # Rounding of 100 rad/s over an interval of a second.
        assert np.max(slopes, initial=0.0) <= ROBOT.max_rotor_acceleration + 1e-6


@pytest.mark.parametrize(("case", "seen"), [(1, 12.3), (2, 12.6), (3, 6.6), (4, 8.6)])
def test_case_of_the_paper_settles_at_its_known_time(case: int, seen: float) -> None:
    found = run(case, 20.0)
    # Four sample periods: cases 1 and 2 pass near several local minima, and another compiler's
    # rounding may choose another one.
    assert abs(settling_time(case, found) - seen) <= 2.0
    assert errors(case, found)[-1] < 1e-3
    limits_are_kept(found)
    # The paper states less than 3.2 N m.
    assert np.max(np.abs(found.torques)) < 3.2
    assert all(d.solved for d in found.decisions)


def test_case_4_with_noise_and_wrong_parameters_stays_near_the_goal() -> None:
    rng = np.random.default_rng(0)
    fields = ("shell_mass", "shell_radius", "shell_inertia", "rotor_mass", "rotor_axial_inertia")
    wrong = RobotParameters(**{f: getattr(ROBOT, f) * rng.uniform(0.97, 1.03) for f in fields})
    found = run(4, 18.0, robot=wrong, process_noise=3e-4, seed=1)
    tail = errors(4, found)[found.times > 12.0]
    # Medians of 0.018 to 0.038 and excursions of up to 0.5 were seen over eight seeds.
    assert np.median(tail) < 0.06
    assert np.max(tail) < 1.0
    limits_are_kept(found)


def test_plans_made_ahead_and_sent_late_reach_the_goal_as_exactly() -> None:
    """While a plan is made the previous one is followed, also across its knots."""
    settings, scenario = ControllerSettings(strategy="time_optimal"), PAPER_CASES[1]
    start = tuple(float(v) for v in scenario.start)
    simulator = Simulator(SimulatorSettings(initial_state=start), ROBOT)
    controller = Controller(settings, ROBOT)
    controller.set_goal(scenario.goal)
    for tick, ahead in zip(
        np.arange(0.0, 9.0, settings.control_period), itertools.cycle(3 * (0.125,) + 3 * (0.03,))
    ):
        simulator.advance_to(round(tick * NANOSECONDS))
        controller.observe(tick, simulator.measured_state())
        decision = controller.decide(tick + ahead)
        sent = tick + 0.5 * ahead
        simulator.advance_to(round(sent * NANOSECONDS))
        hold = controller.commit(decision, sent)
        if hold is not None:
            simulator.follower.follow_trajectory(hold)
    assert state_error(simulator.plant.state, scenario.goal) < 1e-4
    assert controller.estimator.plant.noise < 1e-4


@pytest.mark.parametrize("latency", [0.05, 0.7])
def test_age_of_a_pose_is_the_latency_and_the_state_is_predicted(latency: float) -> None:
    settings = ControllerSettings(pose_timeout=2.0)
    found = run(3, 3.0, settings, latency=latency)
    for k, decision in enumerate(found.decisions):
        assert decision.solved and decision.state is not None
        # Before the run the sphere is at rest, so that the first poses have the stamp 0.
        time = k * settings.control_period
        assert decision.pose_age == pytest.approx(min(latency, time), abs=1e-9)
        assert np.linalg.norm(decision.state[POSE] - found.states[round(time / 0.05)]) < 1e-3


@pytest.mark.parametrize(
    ("strategy", "plant"), [("paper", "rolling"), ("time_optimal", "rigid_body")]
)
def test_slow_noisy_late_and_lost_poses_lead_near_the_goal(strategy: str, plant: str) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    noise, angle_noise = 0.005, float(np.radians(1.0))
    settings = ControllerSettings(
        strategy=strategy, planning_effort=60_000, pose_position_noise=noise,
        pose_orientation_noise=angle_noise,
    )
    found = run(
        3, 12.0, settings, plant=plant, seed=3, position_noise=noise,
        orientation_noise=angle_noise, sensor_rate=20.0, sensor_latency=0.05, sensor_dropout=0.2,
    )
    states, goal = found.states[found.times > 8.0], PAPER_CASES[3].goal
    assert np.max(position_errors(states, goal)) < 0.03
    assert np.max(angle_errors(states, goal)) < np.radians(3.0)


class ChangedOnTheWay(Controller):
    """Controller of which a setting without influence on its plans changes on the way."""

    def decide(self, time: float, time_budget: float = float("inf")) -> Decision:
        if time == 1.0:
            self.change(replace(self._settings, pose_timeout=0.7))
        return super().decide(time, time_budget)


def test_change_of_an_unrelated_setting_changes_no_plan() -> None:
    settings = ControllerSettings(strategy="time_optimal", planning_effort=60_000)
    found, undisturbed = (
        run(3, 4.0, settings, kind(settings, ROBOT)) for kind in (ChangedOnTheWay, Controller)
    )
    np.testing.assert_array_equal(found.states, undisturbed.states)


@pytest.mark.parametrize("torque", [1.6, None])
def test_unknown_drives_cost_little_time(torque: float | None) -> None:
    """The lag of strong drives and the acceleration that weak ones attain are found."""
    pytest.importorskip("mujoco")
    # 2.9 s were seen with weak drives, 11.1 s where their delay was taken for wrong constants, for
    # a lag or for momentum; 1.57 s on the ideal plant.
    body, case = RigidBodySettings(torque_limit=torque or 0.0), PAPER_CASES[3]
    plant = RigidBodyPlant(ROBOT, case.start, body)
    simulator = Simulator(SimulatorSettings(initial_state=tuple(case.start)), ROBOT, plant)
    settings = ControllerSettings()
    controller = Controller(settings, ROBOT)
    found = run_closed_loop(simulator, controller, case.goal, 5.0, settings.control_period)
    estimated = controller.estimator.plant
    if torque is None:
        assert settling_time(3, found) < 2.0 and errors(3, found)[-1] < 1e-3
        lag = 1.0 / body.for_robot(ROBOT).drive_bandwidth
        assert estimated.lag == pytest.approx(lag, abs=5e-4)
    else:
        assert settling_time(3, found) < 3.5
        attained = torque / ROBOT.rotor_axial_inertia
        # The shell turns against its rotors, which attain a few per cent more relative to it.
        assert attained < estimated.acceleration < 1.1 * attained
