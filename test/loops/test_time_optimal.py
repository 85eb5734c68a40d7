# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Search for the earliest arrival, and the strategy in closed loop."""

import dataclasses
import itertools
import time

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, flipped_sign, state_error, without_momentum
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.background import solver_for
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="time_optimal")
HIGH_RATE = ControllerSettings(strategy="time_optimal", control_rate=100.0)
PERIOD = SETTINGS.period
TUNING = TimeOptimalSettings()
SOLVER = solver_for(ROBOT, TUNING)
LIMIT = ROBOT.max_rotor_acceleration
AT_ORIGIN = np.array([0, 0, 1.0, 0, 0, 0])


def situation(scenario: Scenario) -> Situation:
    start = without_momentum(scenario.start)
    return Situation(0.0, start, scenario.goal, np.zeros(2), ROBOT.lumped)


def run(
    scenario: Scenario,
    duration: float,
    robot: RobotParameters = ROBOT,
    settings: ControllerSettings = SETTINGS,
    **world: float,
) -> Trajectory:
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(scenario.start), **world),  # type: ignore[arg-type]
        robot,
    )
    controller = Controller(settings, ROBOT)
    return run_closed_loop(simulator, controller, scenario.goal, duration, settings.control_period)


def errors(found: Trajectory, goal: Vector) -> Vector:
    return np.array([state_error(state, goal) for state in found.states])


def settling_time(found: Trajectory, goal: Vector, within: float = 1e-2) -> float:
    outside = np.flatnonzero(errors(found, goal) > within)
    return float(found.times[outside[-1] + 1]) if outside.size else 0.0


def test_search_stops_at_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    readings = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: next(readings))
    search = ArrivalSearch(SOLVER, situation(PAPER_CASES[1]), 5)
    # The clock advances by a second with each reading, and is read before each initial guess.
    search.improve(100_000_000, deadline=4.5)
    assert 0 < search.work < 20_000
    done = search.work
    search.improve(100_000_000, deadline=4.5)
    assert search.work == done


def check_limits(speeds: Vector, times: Vector) -> None:
    assert np.max(np.abs(speeds)) <= ROBOT.max_rotor_speed + 1e-9
    slopes = np.diff(speeds, axis=0) / np.diff(times)[:, None]
    assert np.max(np.abs(slopes)) <= ROBOT.max_rotor_acceleration + 1e-6


def test_arrival_satisfies_every_limit_and_brings_the_plant_to_the_goal() -> None:
    scenario = PAPER_CASES[2]
    found = ArrivalSearch(SOLVER, situation(scenario), 0).improve(60_000)
    assert found is not None and found.error <= TUNING.arrival_error
    np.testing.assert_array_equal(found.hold.speeds[[0, -1]], np.zeros((2, 2)))
    plan = TimeOptimalStrategy(SETTINGS, ROBOT).plan(situation(scenario))
    plant = RollingPlant(ROBOT, scenario.start)
    for hold in (found.hold, plan.hold):
        check_limits(hold.speeds, hold.times)
        plant.reset(scenario.start)
        for speeds, duration in zip(hold.speeds[1:], np.diff(hold.times), strict=True):
            plant.advance(speeds, float(duration))
        # Steps of 62.5 ms err by 1e-5 each at full speed, amplified on the way.
        assert state_error(plant.state, scenario.goal) < 1e-3


def test_search_goes_on_from_what_it_found_repeats_itself_and_never_gets_worse() -> None:
    first, second = (
        ArrivalSearch(SOLVER, situation(PAPER_CASES[1]), 3) for _ in range(2)
    )
    durations = []
    for _ in range(4):
        found, again = first.improve(20_000), second.improve(20_000)
        durations.append(np.inf if found is None else found.duration)
    assert durations == sorted(durations, reverse=True)
    assert durations[-1] < 7.5
    assert found is not None and again is not None
    np.testing.assert_array_equal(found.hold.speeds, again.hold.speeds)


def test_present_state_as_goal_needs_no_motion_with_either_sign() -> None:
    state = PAPER_CASES[1].start
    for goal in (state, flipped_sign(state)):
        found = run(Scenario(state, goal), 2.0)
        np.testing.assert_array_equal(found.speeds, 0.0)
        assert found.decisions[-1].plan.status is PlanStatus.HOLDING


@pytest.mark.parametrize("settings", [SETTINGS, HIGH_RATE], ids=["4 Hz", "100 Hz"])
def test_used_and_reset_strategy_plans_like_a_new_one(settings: ControllerSettings) -> None:
    def plans(strategy: TimeOptimalStrategy, case: int) -> list[Vector]:
        now, found = situation(PAPER_CASES[case]), []
        for k in range(1, 5):
            plan = strategy.plan(now)
            found.append(plan.hold.speeds)
            time = k * settings.control_period
            state, speeds = plan.states[min(1, len(plan.states) - 1)], plan.hold.at(time)
            now = dataclasses.replace(now, time=time, state=state, input_in_force=speeds)
        return found

    used = TimeOptimalStrategy(settings, ROBOT)
    plans(used, 2)
    slippery = dataclasses.replace(situation(PAPER_CASES[4]), noise=0.02)
    used.plan(slippery)
    used.reset()
    expected = plans(TimeOptimalStrategy(settings, ROBOT), 1)
    for found, wanted in zip(plans(used, 1), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(
    ("case", "limit", "rate"),
    [(1, 6.5, 0.0), (2, 4.5, 0.0), (3, 1.75, 0.0), (4, 2.0, 0.0), (3, 2.25, 30.0), (3, 2.25, 1e2)],
)
def test_case_of_the_paper_settles_near_the_time_limit(
    case: int, limit: float, rate: float
) -> None:
    """Between two knots a plan changes its slope at a near one, without which it is no plan."""
    scenario, settings = PAPER_CASES[case], ControllerSettings(control_rate=rate)
    found = run(scenario, limit + 1.0, settings=settings, **({"pose_rate": rate} if rate else {}))
    assert settling_time(found, scenario.goal) <= limit
    assert errors(found, scenario.goal)[-1] < 1e-4
    check_limits(found.speeds, found.times)
    arrivals = np.array([d.plan.arrival for d in found.decisions])
    arrivals = arrivals[np.isfinite(arrivals)]
    # By what the integration error of the plan takes to correct.
    assert rate or np.all(np.diff(arrivals) <= 1e-3), "never delayed without disturbance"


def test_goal_that_changes_every_second_violates_no_limit() -> None:
    rng, before = np.random.default_rng(8), np.zeros(2)
    simulator = Simulator(SimulatorSettings(initial_state=tuple(AT_ORIGIN)), ROBOT)
    controller = Controller(dataclasses.replace(SETTINGS, planning_effort=20_000), ROBOT)
    for k in range(16):
        if k % 4 == 0:
            turn = rng.normal(size=4)
            place = rng.uniform(-1.0, 1.0, 2)
            controller.set_goal(np.concatenate((place, turn / np.linalg.norm(turn))))
        controller.observe(simulator.time, simulator.measured_state())
        hold = controller.commit(controller.decide(simulator.time), simulator.time)
        assert hold is not None
        simulator.follower.follow_trajectory(hold)
        for _ in range(25):
            simulator.advance_to(simulator.now + 10_000_000)
            after = simulator.plant.rotor_speeds
            check_limits(np.vstack((before, after)), np.array([0.0, 0.01]))
            before = after
    assert controller.failures == 0


def test_attained_acceleration_is_used_and_no_time_leads_to_no_plan() -> None:
    now = situation(PAPER_CASES[3])
    weak = dataclasses.replace(now, acceleration=0.5 * LIMIT)
    assert steepest(TimeOptimalStrategy(SETTINGS, ROBOT).plan(weak)) <= 0.5 * LIMIT
    plan = TimeOptimalStrategy(SETTINGS, ROBOT).plan(now)
    assert plan.status is PlanStatus.SOLVED
    beyond = dataclasses.replace(now, acceleration=1.1 * LIMIT)
    same = TimeOptimalStrategy(SETTINGS, ROBOT).plan(beyond)
    np.testing.assert_array_equal(same.hold.speeds, plan.hold.speeds)
    late = TimeOptimalStrategy(SETTINGS, ROBOT).plan(dataclasses.replace(now, time_budget=0.0))
    assert late.status is PlanStatus.RAMP_TO_REST and not np.any(late.hold.speeds)


def steepest(plan: Plan) -> float:
    slopes = np.diff(plan.hold.speeds, axis=0) / np.diff(plan.hold.times)[:, None]
    return float(np.max(np.abs(slopes)))


def advanced(now: Situation, hold: FirstOrderHold) -> Situation:
    """Return the situation a sample period later, with `hold` as planned."""
    ends = np.array([now.time, now.time + PERIOD])
    inputs = np.array([hold.at(end) for end in ends])
    state = roll_out(now.state, inputs, np.diff(ends), ROBOT.lumped.as_array(), 0.05)[-1]
    return dataclasses.replace(now, time=float(ends[1]), state=state, input_in_force=inputs[1])


def test_plan_that_is_followed_keeps_to_an_acceleration_learnt_meanwhile() -> None:
    attained, now = 300.0, situation(PAPER_CASES[1])
    strategy = TimeOptimalStrategy(SETTINGS, ROBOT)
    plan = strategy.plan(now)
    assert steepest(plan) > 1.2 * attained
    moving = dataclasses.replace(advanced(now, plan.hold), acceleration=attained)
    slower = strategy.plan(moving)
    assert slower.status is PlanStatus.SOLVED
    assert steepest(slower) < TUNING.attained_share * attained + 1e-3


@pytest.mark.parametrize(
    ("away", "error"),
    [
        ([2e-3, -1e-3, 2e-3, 1e-3, -4e-3], 2e-4),
        ([1.5e-3, 0.0, 0.0, 0.0, 0.0], 1.5e-3),
    ],
    ids=["beyond", "within the dead band"],
)
def test_near_goal_is_reached_exactly_unless_it_is_within_the_dead_band(
    away: list[float], error: float
) -> None:
    """A manoeuvre that corrects a millimetre leads through large errors."""
    goal = apply_error(AT_ORIGIN, np.array(away))
    found = errors(run(Scenario(AT_ORIGIN, goal), 5.0), goal)[-1]
    assert found < error if error < 1e-3 else found == pytest.approx(error, rel=1e-12)
