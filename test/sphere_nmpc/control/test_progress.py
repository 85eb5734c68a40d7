# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Missing progress is told with its cause, for robots of any size, and nothing else is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from delayed_worker import DelayedWorker
from robots import SIZES
from standing import Standing

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision, Mode
from sphere_nmpc.control.progress import Progress
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, make_state
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
ROBOTS = {"Table 1": ROBOT, **SIZES}
START = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
GOAL = make_state((1.0, 0.0), (1.0, 0.0, 0.0, 0.0))
AT_REST = np.zeros(2)


class Blocked(Simulator):
    """Simulator of a sphere that does not move, whatever its rotors do."""

    def advance_to(self, then: int) -> None:
        """Let time pass."""
        self.now = then


def closed_loop(
    controller: Controller, settings: ControllerSettings, duration: float,
    kind: type[Simulator] = Simulator, robot: RobotParameters = ROBOT, **world: Any,
) -> Trajectory:
    simulator = kind(
        SimulatorSettings(
            initial_state=tuple(START), **world
        ), robot,
    )
    return run_closed_loop(
        simulator, controller, GOAL, duration, settings.control_period, output_period=0.1
    )


def first_missing(run: Trajectory) -> Decision:
    return next(d for d in run.decisions if d.mode is Mode.NO_PROGRESS)


def decision(plan: Plan, state: Vector = START, drift: Drift | None = None) -> Decision:
    found = Decision.with_error(Mode.TRACKING, plan, state, GOAL, 0.0, None, Drift())
    return found if drift is None else replace(found, drift=drift)


def plan(situation_time: float, speeds: Vector = AT_REST, **values: Any) -> Plan:
    status = values.pop("status", PlanStatus.SOLVED)
    hold = FirstOrderHold(
        situation_time + np.array([0.0, 1.0]), np.vstack((AT_REST, speeds))
    )
    return Plan(status, hold, START[None, :], **values)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
@pytest.mark.parametrize("period", [0.1, 0.5, 2.3])
def test_strategy_that_stands_still_is_told_within_some_periods(robot, period) -> None:
    settings = ControllerSettings(strategy="paper", sample_period=period)
    controller = Controller(settings, robot, Standing(message="converged"))
    patience = max(5.0, 6.0 * period)
    run = closed_loop(controller, settings, patience + 2.0 * period, robot=robot)
    modes = [d.mode for d in run.decisions]
    first = modes.index(Mode.NO_PROGRESS) * period
    assert patience <= first + 1e-9 < patience + 1.01 * period
    assert set(modes[: modes.index(Mode.NO_PROGRESS)]) == {Mode.TRACKING}
    found = run.decisions[-1]
    assert found.solved and found.mode is Mode.NO_PROGRESS
    assert found.no_progress.startswith("given a sphere that has stood 1 from its goal for ")
    assert found.no_progress.endswith("the plan leaves it where it is (solved: converged)")


def test_control_rate_does_not_matter() -> None:
    settings = ControllerSettings(strategy="paper", control_rate=50.0)
    run = closed_loop(Controller(settings, ROBOT, Standing()), settings, 6.0)
    first = [d.mode for d in run.decisions].index(Mode.NO_PROGRESS) * settings.control_period
    assert 5.0 <= first + 1e-9 < 5.0 + settings.period


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_sphere_that_ignores_its_rotors_is_told(robot) -> None:
    settings = ControllerSettings(strategy="paper", momentum=False).of(robot)
    strategy = Standing(0.5 * robot.max_rotor_speed)
    duration = max(6.0, 8.0 * settings.period)
    found = closed_loop(Controller(settings, robot, strategy), settings, duration, Blocked, robot)
    assert "is it blocked, do its rotors turn" in first_missing(found).no_progress


@pytest.mark.slow
@pytest.mark.parametrize("momentum", [True, False])
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_blocked_sphere_is_told_also_where_it_looks_like_momentum(strategy, momentum) -> None:
    """With `momentum` what the rotors do without effect is taken for momentum that they hold."""
    settings = ControllerSettings(strategy=strategy, momentum=momentum)
    run = closed_loop(Controller(settings, ROBOT), settings, 6.0, Blocked)
    assert "is it blocked, do its rotors turn" in first_missing(run).no_progress


def test_robot_that_waits_for_a_plan_is_told_so() -> None:
    settings = ControllerSettings()
    worker = DelayedWorker(lambda: 0.0, 1.0)
    run = closed_loop(Controller(settings, ROBOT, worker=worker), settings, 5.6)
    assert first_missing(run).no_progress.endswith("there is no plan: no arrival found yet")


def test_what_a_strategy_gives_up_is_told() -> None:
    settings = ControllerSettings()
    strategy = Standing(
        status=PlanStatus.HOLDING, given_up="orientation by 30.0 deg: too much"
    )
    run = closed_loop(Controller(settings, ROBOT, strategy), settings, 5.6)
    assert first_missing(run).no_progress.endswith(
        "the strategy gives up orientation by 30.0 deg: too much"
    )


def test_progress_and_another_goal_end_it() -> None:
    settings = ControllerSettings(strategy="paper")
    controller = Controller(settings, ROBOT, Standing())
    closed_loop(controller, settings, 6.0)
    controller.observe(6.5, START)
    assert controller.decide(6.5).mode is Mode.NO_PROGRESS
    controller.observe(7.0, make_state((0.1, 0.0), START[2:]))
    assert controller.decide(7.0).mode is Mode.TRACKING
    controller.observe(12.5, make_state((0.1, 0.0), START[2:]))
    assert controller.decide(12.5).mode is Mode.NO_PROGRESS
    controller.set_goal(make_state((2.0, 0.0), START[2:]))
    controller.observe(13.0, make_state((0.1, 0.0), START[2:]))
    assert controller.decide(13.0).mode is Mode.TRACKING


def missing(states: list[Vector], **settings: Any) -> list[str]:
    """Return the results of the detector for a pose every half second."""
    progress, chosen = Progress(ROBOT), ControllerSettings(strategy="paper", **settings)
    times = 0.5 * np.arange(len(states))
    return [
        progress.update(float(t), s, GOAL, AT_REST, decision(plan(float(t)), s), chosen)
        for t, s in zip(times, states, strict=True)
    ]


def at(x: float, turn: float = 0.0) -> Vector:
    return make_state((x, 0.0), (np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)))


def test_slow_approach_is_progress() -> None:
    assert not any(missing([at(1.0 - 0.03 * 0.99**k) for k in range(100)]))
    assert any(missing([at(1.0 - 0.03 * 0.999**k) for k in range(100)]))


def test_motion_is_no_standing_whatever_the_error() -> None:
    """On the way round an obstacle, or turning on the spot, the error may rise."""
    assert not any(missing([at(-0.005 * k) for k in range(60)]))
    assert not any(missing([at(0.0, 0.01 * k) for k in range(60)]))
    assert any(missing([at(-0.0005 * k) for k in range(60)]))


@pytest.mark.parametrize("x", [0.0, 0.8])
def test_noise_neither_hides_a_stand_nor_makes_one_of_a_rest_at_the_goal(x) -> None:
    rng = np.random.default_rng(3)
    position, turn = 5e-3, 0.017

    def noisy(x: float) -> Vector:
        return at(x + position * rng.normal(), turn * rng.normal())

    noise = {"pose_position_noise": position, "pose_orientation_noise": turn}
    assert any(missing([noisy(x) for _ in range(60)], **noise))
    assert not any(missing([noisy(0.985) for _ in range(200)], **noise))


def test_momentum_that_is_held_is_no_motion() -> None:
    drift = Drift(momentum=np.array([20.0, -30.0, 0.0]))
    progress, settings = Progress(ROBOT), ControllerSettings()
    held = drift.rest_speeds(START[2:])
    found = ""
    for time in 0.25 * np.arange(30):
        hold = FirstOrderHold.constant(float(time), held)
        made = Plan(PlanStatus.SOLVED, hold, START[None, :])
        found = progress.update(
            float(time), START, GOAL, held, decision(made, START, drift), settings
        )
    assert found.endswith("the plan leaves it where it is (solved)")


def test_plans_that_only_ever_move_it_later_are_told() -> None:
    progress, settings, found = Progress(ROBOT), ControllerSettings(), ""
    for time in 0.25 * np.arange(30):
        later = decision(plan(float(time), np.array([50.0, 0.0])))
        found = progress.update(float(time), START, GOAL, AT_REST, later, settings)
    assert found.endswith("each plan begins at rest and moves it later (solved)")


def test_clock_that_is_set_back_begins_anew() -> None:
    progress, settings = Progress(ROBOT), ControllerSettings()
    for time, expected in ((0.0, False), (6.0, True), (1.0, False), (5.0, False), (6.5, True)):
        found = progress.update(time, START, GOAL, AT_REST, decision(plan(time)), settings)
        assert bool(found) is expected


@pytest.mark.slow
@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_runs_that_settle_are_not_told_to_stand(strategy, noise) -> None:
    told: dict[str, Any] = {}
    world: dict[str, Any] = {}
    if noise:
        told = {"pose_position_noise": 5e-3, "pose_orientation_noise": 0.017}
        world = {"position_noise": 5e-3, "orientation_noise": 0.017, "sensor_rate": 20.0}
    settings = ControllerSettings(strategy=strategy, **told)
    # With noise, which is estimated all the way, a run takes ten times as long.
    for scenario in draw_scenarios(1 if noise else 2, 1):
        simulator = Simulator(
            SimulatorSettings(
                initial_state=tuple(scenario.start),
                **world,
            ), ROBOT,
        )
        run = run_closed_loop(
            simulator, Controller(settings, ROBOT), scenario.goal, 25.0,
            settings.control_period, 0.1,
        )
        assert run.decisions[-1].error < (0.1 if noise else 1e-2)
        assert Mode.NO_PROGRESS not in {d.mode for d in run.decisions}
