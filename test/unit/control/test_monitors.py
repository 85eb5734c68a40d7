# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Arrival, missing progress with its cause, steps of the pose, and the reserve of the rotors."""

import math

import numpy as np
import pytest
from delayed_worker import DelayedWorker
from given_plans import Standing
from robots import PALM

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.monitors import ArrivalDetector, Progress, rotor_reserve
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, make_state, state_error, without_momentum
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import NANOSECONDS, Simulator

ROBOT = RobotParameters()
START = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
GOAL = make_state((1.0, 0.0), (1.0, 0.0, 0.0, 0.0))
AT_REST = np.zeros(2)
TOLERANCE, DWELL = 0.01, 0.25
TICK = NANOSECONDS // 100


LEFT = [(1.0, math.nan), (1.5, 1.0), (4.14, 0.005), (4.5, 0.001), (5.0, 0.5), (6.0, 0.1),
        (7.5, 0.001), (8.0, 0.001)]


@pytest.mark.parametrize(
    ("samples", "reached", "took"),
    [
        ([(0.0, 0.009), (0.24, 0.009), (0.25, 0.009)], [2], 0.0),
        ([(0.0, 0.009), (0.1, 0.011), (0.3, 0.009)], [], None),
        ([(0.0, 0.0), (0.3, 0.0), (0.4, 0.019), (0.5, 0.021)], [1, 2], None),
        ([(0.0, 0.0), (0.3, 0.0), (0.4, 0.021), (0.5, 0.015)], [1], None),
        ([(0.0, math.nan), (0.3, math.nan)], [], None),
        ([(5.0, 0.0), (0.0, 0.0), (0.1, 0.0), (0.3, 0.0)], [3], 0.0),
        (LEFT[:4], [3], 3.14),
        (LEFT, [3, 7], 2.5),
        # The pose is lost at the goal, and on the way back.
        ([*LEFT, None, (9.0, 0.02), None, (10.0, 0.02), (10.5, 0.001), (11.0, 0.001)],
         [3, 7, 13], 1.5),
    ],
    ids=["stays", "passes", "noise at the limit", "pushed away", "unknown", "clock set back",
         "from the first sample", "from when it was left", "lost"],
)
def test_goal_is_reached_when_the_error_stays_within_the_tolerance(samples, reached, took) -> None:
    arrival, found = ArrivalDetector(), []
    for k, sample in enumerate(samples):
        if sample is None:
            arrival.reset()
        elif arrival.update(sample[0], sample[1] / TOLERANCE, DWELL):
            found.append(k)
    assert found == reached
    assert took is None or arrival.took == pytest.approx(took)


class Blocked(Simulator):
    """Simulator of a sphere that does not move, whatever its rotors do."""

    def advance_to(self, then: int) -> None:
        """Let time pass."""
        self.now = then


def closed_loop(
    controller: Controller, duration: float,
    kind: type[Simulator] = Simulator, robot: RobotParameters = ROBOT, **world: float,
) -> Trajectory:
    simulated = SimulatorSettings(initial_state=tuple(START), **world)
    simulator = kind(simulated, robot)
    return run_closed_loop(simulator, controller, GOAL, duration, 0.1)


def first_missing(run: Trajectory) -> str:
    return next(d.conditions[0].text for d in run.decisions if d.mode is Kind.NO_PROGRESS)


@pytest.mark.parametrize(("robot", "period"), [(ROBOT, 0.1), (PALM, 0.5)])
def test_strategy_that_stands_still_is_told_within_some_periods(robot, period) -> None:
    settings = ControllerSettings(strategy="paper", sample_period=period)
    told = Condition(Kind.PLANNED, "converged")
    controller = Controller(settings, robot, Standing(conditions=(told,)))
    patience = max(5.0, 6.0 * settings.period)
    run = closed_loop(controller, patience + 2.0 * settings.period, robot=robot)
    modes = [d.mode for d in run.decisions]
    first = modes.index(Kind.NO_PROGRESS)
    late = first * settings.control_period - patience
    assert 0.0 <= late + 1e-9 < 1.01 * settings.period
    assert set(modes[:first]) == {Kind.TRACKING} and modes[-1] is Kind.NO_PROGRESS
    assert run.decisions[-1].solved
    told = first_missing(run)
    assert told.startswith("given a sphere that has stood for ")
    assert ", error 1, expected motion; " in told
    assert told.endswith("the plan leaves it where it is (solved: converged)")


@pytest.mark.parametrize(
    ("values", "parts", "kind", "cause"),
    [
        # What the rotors do without effect is taken for momentum that they hold.
        ({"planning_effort": 20_000}, {}, Blocked, "is it blocked, do its rotors turn"),
        ({"strategy": "paper", "momentum": False}, {}, Blocked, "is it blocked, do its rotors"),
        ({}, {"worker": DelayedWorker(lambda: 0.0, 1.0)}, Simulator,
         "there is no plan: no arrival found yet"),
        ({}, {"strategy": Standing(
            status=PlanStatus.HOLDING, conditions=(Condition(Kind.GIVEN_UP, "turns: too much"),)
        )},
         Simulator, "the strategy gives up turns: too much"),
    ],
    ids=["blocked", "blocked, paper", "waits for a plan", "gives up"],
)
def test_cause_of_missing_progress_is_told(values, parts, kind, cause) -> None:
    settings = ControllerSettings(**values)
    run = closed_loop(Controller(settings, ROBOT, **parts), 5.6, kind)
    assert cause in first_missing(run)


def test_sphere_that_rests_where_noise_hides_the_rest_of_its_error_is_told_so() -> None:
    settings = ControllerSettings(goal_tolerance=1e-3)
    run = closed_loop(
        Controller(settings, ROBOT), 14.0, position_noise=5e-3, orientation_noise=5e-3,
        pose_rate=100.0,
    )
    assert first_missing(run).endswith("less noise of the poses, or a larger goal_tolerance")
    assert {d.mode for d in run.decisions} == {Kind.TRACKING, Kind.NO_PROGRESS}


def test_progress_and_another_goal_end_it() -> None:
    settings = ControllerSettings(strategy="paper")
    controller = Controller(settings, ROBOT, Standing())
    closed_loop(controller, 6.0)
    here = make_state((0.1, 0.0), START[2:])
    for time, pose, mode in (
        (6.5, START, Kind.NO_PROGRESS), (7.0, here, Kind.TRACKING), (12.5, here, Kind.NO_PROGRESS)
    ):
        controller.observe(time, pose)
        assert controller.decide(time).mode is mode
    controller.set_goal(make_state((2.0, 0.0), START[2:]))
    controller.observe(13.0, here)
    assert controller.decide(13.0).mode is Kind.TRACKING


def missing(poses: list[Vector], **settings: float) -> list[Condition | None]:
    """Return the results of the detector for a pose every half second and plans of rest."""
    progress, found = Progress(ROBOT), []
    chosen = ControllerSettings(strategy="paper", **settings)  # type: ignore[arg-type]
    plan = Plan(FirstOrderHold.constant(0.0, AT_REST), START[None, :])
    for k, pose in enumerate(poses):
        decision = Decision(Kind.TRACKING.conditions, plan, without_momentum(pose), GOAL, 0.0)
        found.append(progress.update(0.5 * k, pose, GOAL, lambda _: AT_REST, decision, chosen))
    return found


def at(x: float, turn: float = 0.0) -> Vector:
    return make_state((x, 0.0), (np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)))


RNG = np.random.default_rng(3)
POSITION_NOISE, TURN_NOISE = 5e-3, 0.017
NOISE = {"pose_position_noise": POSITION_NOISE, "pose_orientation_noise": TURN_NOISE}


def noisy(x: float, count: int) -> list[Vector]:
    return [at(x + POSITION_NOISE * RNG.normal(), TURN_NOISE * RNG.normal()) for _ in range(count)]


@pytest.mark.parametrize(
    ("poses", "settings", "is_missing"),
    [
        ([at(1.0 - 0.03 * 0.99**k) for k in range(100)], {}, False),
        ([at(1.0 - 0.03 * 0.999**k) for k in range(100)], {}, True),
        # On the way round an obstacle, or turning on the spot, the error may rise.
        ([at(-0.005 * k) for k in range(60)], {}, False),
        ([at(0.0, 0.01 * k) for k in range(60)], {}, False),
        ([at(-0.0005 * k) for k in range(60)], {}, True),
        # Within the tolerance of the error in R^6, but not within that of the position.
        ([at(0.995)] * 20, {}, False),
        ([at(0.995)] * 20, {"position_tolerance": 1e-3}, True),
        (noisy(0.8, 60), NOISE, True),
        (noisy(0.985, 200), NOISE, False),
    ],
    ids=["slow", "too slow", "away", "turns", "creeps away", "near", "not near enough",
         "stands, noisy", "rests at the goal, noisy"],
)
def test_slow_approach_and_motion_are_progress_and_noise_is_not(
    poses, settings, is_missing
) -> None:
    assert any(missing(poses, **settings)) is is_missing


def test_simulator_that_is_reset_on_the_way_is_taken_for_no_momentum() -> None:
    simulator = Simulator(SimulatorSettings(initial_state=tuple(START)), ROBOT)
    settings = ControllerSettings(planning_effort=20_000)
    controller = Controller(settings, ROBOT)
    period = round(settings.control_period * NANOSECONDS)
    controller.set_goal(np.array([2.0, -1.0, 1.0, 0.0, 0.0, 0.0]))
    modes, largest = set(), 0.0
    for now in range(0, 700 * TICK, TICK):
        simulator.advance_to(now)
        if now == 200 * TICK:
            simulator.reset()
            controller.set_goal(START)
            modes.clear()
        controller.observe(simulator.time, simulator.plant.state)
        if now % period == 0:
            decision = controller.decide(simulator.time)
            hold = controller.commit(decision, simulator.time)
            if hold is not None:
                simulator.follower.follow_trajectory(hold)
            modes.add(decision.mode)
            largest = max(largest, float(np.max(np.abs(decision.momentum))))
    assert controller.pose_gate.jumps == 1
    assert modes == {Kind.POSE_JUMPED, Kind.TRACKING, Kind.AT_GOAL}
    assert largest < 1.0, "no momentum was ever there [rad/s]"
    assert state_error(simulator.plant.state, START) < 1e-2


@pytest.mark.parametrize(
    ("momentum", "slope", "expected"),
    [
        (0.0, 0.0, ""), (69.0, 7.0, ""), (90.0, 0.0, ""), (90.0, -2.0, ""), (80.0, 0.3, ""),
        (80.0, 4.0, "given 80 of 100 rad/s to hold the momentum at the goal, and 5.0 s until"),
        (120.0, 0.0, "given a momentum that needs 120 rad/s"),
    ],
)
def test_time_that_rotors_have_left_is_told_where_it_is_short(momentum, slope, expected) -> None:
    held = np.array([0.0, momentum, 0.0])
    found = rotor_reserve(held, Disturbance(np.array([0.0, slope])), ROBOT, START)
    assert (found is not None) == bool(expected)
    assert found is None or found.text.startswith(expected)
