# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops without ROS: the paper's cases, late and noisy poses, weak drives, a lossy link."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sampled_loop import ROBOT, SampledLoop, check_hold

from sphere_nmpc.model.disturbance import is_zero
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import POSE, Vector, flipped_sign, make_state, upright_state
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors, state_errors, stay_below
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

pytestmark = pytest.mark.slow

PAPER = ControllerSettings(strategy="paper")


def of_case(
    case: int, settings: ControllerSettings = ControllerSettings(), **others: Any  # noqa: B008
) -> SampledLoop:
    scenario = PAPER_CASES[case]
    return SampledLoop(scenario.start, settings, goal=scenario.goal, **others)


def trajectory(loop: SampledLoop, duration: float, latency: float = 0.0) -> Trajectory:
    return run_closed_loop(loop.simulator, loop.controller, loop.goal, duration, 0.05, latency)


@pytest.mark.parametrize(("case", "seen"), [(1, 12.3), (2, 12.6), (3, 6.6), (4, 8.6)])
def test_case_of_the_paper_settles_at_its_known_time(case: int, seen: float) -> None:
    loop = of_case(case, PAPER)
    found = trajectory(loop, 20.0)
    errors = state_errors(found.states, loop.goal)
    stay = stay_below(found.times, errors)
    # Four sample periods: cases 1 and 2 pass near several local minima, and another compiler's
    # rounding may choose another one.
    assert stay is not None and abs(stay.since - seen) <= 2.0
    assert errors[-1] < 1e-3
    assert np.max(np.abs(found.rotor_speeds.values)) <= ROBOT.max_rotor_speed
    for hold in found.holds:
        check_hold(hold)
    # The paper states less than 3.2 N m.
    assert np.max(np.abs(found.rotor_torques.values)) < 3.2
    assert all(d.solved for d in found.decisions)


@pytest.mark.parametrize(
    ("case", "seen", "rate"),
    [(1, 5.9, 0.0), (2, 4.0, 0.0), (3, 1.35, 0.0), (4, 1.76, 0.0), (3, 1.3, 30.0), (3, 1.3, 1e2)],
)
def test_case_of_the_paper_settles_in_minimum_time(case: int, seen: float, rate: float) -> None:
    """Between two knots a plan changes its slope at a near one, without which it is no plan."""
    simulated = {"pose_rate": rate} if rate else {}
    loop = of_case(case, ControllerSettings(control_rate=rate), simulated=simulated)
    plans = loop.run(seen + 1.5)
    # A sample period later at the most: rounding may lead the search to another motion.
    assert loop.settled() <= seen + loop.settings.period
    # What a plan leaves, 2e-5, and its integration error.
    assert loop.error() < 1e-4
    loop.check_limits()
    arrivals = np.array([plan.arrival for plan in plans])
    # By what the integration error of the plan takes to correct.
    delays = np.diff(arrivals[np.isfinite(arrivals)])
    assert rate or np.all(delays <= 1e-3), "never delayed without disturbance"


@pytest.mark.parametrize("turn", [lambda state: state, flipped_sign], ids=["same", "other sign"])
def test_present_state_as_goal_needs_no_motion(turn) -> None:
    start = PAPER_CASES[1].start
    loop = SampledLoop(start, goal=turn(start))
    found = trajectory(loop, 2.0)
    assert found.decisions[-1].plan.status is PlanStatus.HOLDING
    np.testing.assert_array_equal(found.rotor_speeds.values, 0.0)


def test_case_4_with_noise_and_wrong_parameters_stays_near_the_goal() -> None:
    rng = np.random.default_rng(0)
    fields = ("shell_mass", "shell_radius", "shell_inertia", "rotor_mass", "rotor_axial_inertia")
    wrong = RobotParameters(**{f: getattr(ROBOT, f) * rng.uniform(0.97, 1.03) for f in fields})
    loop = of_case(4, PAPER, robot=wrong, simulated={"process_noise": 3e-4, "seed": 1})
    loop.run(18.0)
    tail = loop.errors()[np.array(loop.times) > 12.0]
    # Medians of 0.018 to 0.038 and excursions of up to 0.5 were seen over eight seeds.
    assert np.median(tail) < 0.06
    assert np.max(tail) < 1.0
    loop.check_limits()


def test_plans_made_ahead_and_sent_late_reach_the_goal_as_exactly() -> None:
    """While a plan is made the previous one is followed, also across its knots."""
    loop = of_case(1)
    for ahead in itertools.islice(itertools.cycle(3 * (0.125,) + 3 * (0.03,)), 36):
        loop.delay = 0.5 * ahead
        loop.sample(ahead=ahead)
        loop.advance(loop.settings.control_period - loop.delay)
    assert loop.error() < 1e-4
    assert loop.controller.estimator.plant.noise < 1e-4


@pytest.mark.parametrize("latency", [0.05, 0.7])
def test_age_of_a_pose_is_the_latency_and_the_state_is_predicted(latency: float) -> None:
    loop = of_case(3, replace(PAPER, pose_timeout=2.0))
    found = trajectory(loop, 3.0, latency)
    for k, decision in enumerate(found.decisions):
        assert decision.solved and decision.state is not None
        # Before the run the sphere is at rest, so that the first poses have the stamp 0.
        time = k * loop.settings.control_period
        assert decision.pose_age == pytest.approx(min(latency, time), abs=1e-9)
        assert np.linalg.norm(decision.state[POSE] - found.states[round(time / 0.05)]) < 1e-3


@pytest.mark.parametrize(
    ("strategy", "plant"), [("paper", "rolling"), ("time_optimal", "rigid_body")]
)
def test_slow_noisy_late_and_lost_poses_lead_near_the_goal(strategy: str, plant: str) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    noise, angle_noise = 0.005, float(np.radians(1.0))
    loop = of_case(
        3, ControllerSettings(
            strategy=strategy, planning_effort=60_000, pose_position_noise=noise,
            pose_orientation_noise=angle_noise,
        ),
        simulated={
            "plant": plant, "seed": 3, "position_noise": noise, "orientation_noise": angle_noise,
            "sensor_rate": 20.0, "sensor_latency": 0.05, "sensor_dropout": 0.2,
        },
    )
    found = trajectory(loop, 12.0)
    states = found.states[found.times > 8.0]
    # Of the 64 poses received meanwhile some are off by three standard deviations.
    assert np.max(position_errors(states, loop.goal)) < 2.0 * noise
    assert np.max(angle_errors(states, loop.goal)) < 2.0 * angle_noise


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_change_of_unrelated_settings_changes_no_plan(noise: float) -> None:
    settings = ControllerSettings(
        planning_effort=20_000, pose_position_noise=noise, pose_orientation_noise=noise
    )
    changed, unchanged = loops = of_case(3, settings), of_case(3, settings)
    for loop in loops:
        loop.run(0.5)
        if loop is changed:
            loop.controller.change(replace(settings, goal_tolerance=0.02, pose_timeout=0.7))
        loop.run(0.75)
    np.testing.assert_array_equal(changed.states, unchanged.states)


@pytest.mark.parametrize("torque", [1.6, None])
def test_unknown_drives_cost_little_time(torque: float | None) -> None:
    """The lag of strong drives and the acceleration that weak ones attain are found."""
    pytest.importorskip("mujoco")
    # 2.0 s were seen with weak drives, 11.1 s where their delay was taken for wrong constants, for
    # a lag or for momentum; 1.35 s on the ideal plant.
    body = RigidBodySettings(torque_limit=torque or 0.0)
    loop = of_case(3, plant=RigidBodyPlant(ROBOT, PAPER_CASES[3].start, body))
    loop.run(5.0)
    estimated = loop.controller.estimator.plant
    if torque is None:
        assert loop.settled() < 1.6 and loop.error() < 1e-3
        lag = 1.0 / body.for_robot(ROBOT).drive_bandwidth
        assert estimated.lag == pytest.approx(lag, abs=5e-4)
    else:
        assert loop.settled() < 2.5
        attained = torque / ROBOT.rotor_axial_inertia
        # The shell turns against its rotors, which attain a few per cent more relative to it.
        assert attained < estimated.acceleration < 1.1 * attained


@pytest.mark.parametrize(("speed", "acceleration"), [(1e4, 400.0), (1e4, 1e6), (600.0, 400.0)])
def test_goal_is_reached_with_drives_of_any_speed(speed: float, acceleration: float) -> None:
    """Also where a ramp to it would take longer than the motion, and a period would be 2 ms."""
    robot = replace(ROBOT, max_rotor_speed=speed, max_rotor_acceleration=acceleration)
    settings = ControllerSettings().of(robot)
    goal = upright_state(1.0, -1.0, 1.57)
    loop = SampledLoop(upright_state(0.0, 0.0, 0.0), settings, robot, goal=goal, nominal=robot)
    loop.run(3.0 if acceleration < 1e5 else 0.3)
    assert loop.error() < 1e-2


class Wire:
    """One topic over a link; what was overtaken is dropped."""

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


class LinkedLoop(SampledLoop):
    """Loop with a link in between, whose clock may be late, too [s].

    `measured` makes what `joint_states` have of the rotor speeds [rad/s]; None without any.
    """

    def __init__(
        self, delay: float = 0.02, loss: float = 0.0, bursts: tuple[float, ...] = (),
        clock_delay: float = 0.0, measured: Callable[[Vector], Vector] | None = np.copy,
    ) -> None:
        goal = make_state((0.9, -1.1), random_quaternion(np.random.default_rng(1)))
        super().__init__(PAPER_CASES[1].start, goal=goal, simulated={"pose_rate": 50.0})
        self.clock_delay, self.measured = clock_delay, measured
        self.poses, self.joints, self.commands = (
            Wire(seed, delay, loss, bursts) for seed in range(3)
        )
        self._copies: list[tuple[float, FirstOrderHold]] = []

    def go(self) -> float:
        """Return the time to the goal, at which the sphere stays for a second [s]."""
        inside = 0.0
        while self.time < inside + 1.0:
            self.step()
            if self.error() >= 1e-2:
                inside = self.time
            assert self.time < 60.0, "not reached"
        return inside

    def step(self) -> None:
        """Advance by 10 ms: poses and copies of commands come each 20 ms, plans each 250 ms."""
        controller = self.controller
        self.simulator.advance_to(self.simulator.now + 10_000_000)
        true, count = self.time, self.simulator.now // 10_000_000
        now = true - self.clock_delay
        if count % 2 == 0:
            self.poses.send(true, (true, self.pose))
            if self.measured is not None:
                self.joints.send(true, (true, self.measured(self.plant.rotor_speeds)))
        for hold in self.commands.receive(true):
            self.simulator.follower.follow_trajectory(hold)
        for time, speeds in self.joints.receive(true):
            controller.observe_rotors(time, speeds)
        for time, state in self.poses.receive(true):
            controller.link.pose_received(time, now - time)
            controller.observe(time, state)
        while self._copies and self._copies[0][0] <= true:
            self.commands.send(true, self._copies.pop(0)[1])
        if count % 25 == 0:
            decision = controller.decide(now + controller.link.window)
            sent = controller.commit(decision, now)
            if sent is not None:
                self.commands.send(true, sent)
                again = (1, 2) if controller.link.is_apparent else ()
                self._copies = [(true + i * 0.02, sent) for i in again]


def test_without_a_link_nothing_is_committed_ahead() -> None:
    loop = LinkedLoop(delay=0.0)
    loop.go()
    link = loop.controller.link
    assert link.window == link.loss == 0.0 and not link.is_apparent


WRONG_SPEEDS: dict[str, Callable[[Vector], Vector]] = {
    "zero": np.zeros_like,
    "turns per second": lambda speeds: speeds / (2.0 * np.pi),
    "revolutions per minute": lambda speeds: speeds * 30.0 / np.pi,
    "degrees per second": np.degrees,
    "opposite": np.negative,
    "swapped": np.flip,
    "constant": lambda speeds: np.full_like(speeds, 20.0),
    "one zero": lambda speeds: speeds * [1.0, 0.0],
}


@pytest.fixture(scope="module")
def time_without() -> float:
    """Time to the goal without speeds [s]."""
    return LinkedLoop(delay=0.0, measured=None).go()


@pytest.mark.parametrize("measured", WRONG_SPEEDS.values(), ids=WRONG_SPEEDS)
def test_speeds_that_contradict_the_motion_are_left_out(measured, time_without) -> None:
    wrong = LinkedLoop(delay=0.0, measured=measured)
    assert wrong.go() == pytest.approx(time_without, abs=0.05)
    # Others do not look like lost or late commands, so that nothing is made of them.
    if measured in (WRONG_SPEEDS["zero"], WRONG_SPEEDS["turns per second"]):
        assert Kind.SPEEDS_CONTRADICTED in {one.kind for one in wrong.controller.faults}


def test_speeds_of_rotors_that_do_not_turn_are_believed() -> None:
    """Commands are lost from the start on: the sphere stands, as the speeds say."""
    loop = LinkedLoop(delay=0.0)
    loop.commands = Wire(0, 0.0, loss=1.0, bursts=())
    while loop.time < 1.0:
        loop.step()
    sent = loop.controller.rotors
    assert sent.believes_measured and not sent.contradicted
    assert not sent.at(1.0).any()


@pytest.mark.parametrize(
    ("loss", "bursts", "clock_delay"),
    # A burst early on, while the plan still changes: later commands repeat those that were lost.
    [(0.2, (), 0.02), (0.05, (0.5, 10.0, 18.0), 0.0)], ids=["lost", "bursts"],
)
def test_lost_commands_are_no_other_plant_and_cost_little_time(
    loss: float, bursts: tuple[float, ...], clock_delay: float
) -> None:
    loop = LinkedLoop(loss=loss, bursts=bursts, clock_delay=clock_delay)
    took, estimator = loop.go(), loop.controller.estimator
    # Over six goals within 20 mm the worst was 6.4e-4.
    np.testing.assert_allclose(
        estimator.plant.constants.as_array(), ROBOT.lumped.as_array(), rtol=2e-3
    )
    # Up to 5e-4 with measured rotor speeds, up to 1.5e-2 without.
    assert estimator.plant.noise < 1e-3
    assert is_zero(estimator.momentum, estimator.disturbance)
    assert 0.02 < loop.controller.link.window < 0.3
    # Without a link 4.0 s.
    assert took < 4.4


def test_goal_is_reached_without_joint_states() -> None:
    """Commands are then expected to be lost as often as poses."""
    loop = LinkedLoop(loss=0.05, measured=None)
    took, link = loop.go(), loop.controller.link
    assert 0.015 < link.window < 0.03 and 0.02 < link.loss < 0.1
    # Over twelve goals within 0.8 m from 4.0 to 4.4 s; without the window up to 26 s, or never.
    assert took < 4.8
