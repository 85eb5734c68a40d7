# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies of other packages that raise, return or write what they should not."""

import math
import re
import signal
import sys
import types
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from given_plans import Given, plan_of
from motions import largest_slope
from sampled_loop import ROBOT

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.foreign.code import called
from sphere_nmpc.model.course import Leg, LegEnd
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import POSITION, STATE_SIZE, upright_state
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import STRATEGIES, ControllerSettings, StrategyEntry
from sphere_nmpc.strategy.contract import MOST_KNOTS, Situation
from sphere_nmpc.strategy.plan import Made, Plan, PlanStatus
from sphere_nmpc.worker.contract import Worker
from sphere_nmpc.worker.in_line import InLine

SETTINGS = ControllerSettings()
NOISY = ControllerSettings(pose_position_noise=1e-3, pose_orientation_noise=1e-3)
START, GOAL = upright_state(0.0, 0.0, 0.0), upright_state(1.0, 0.0, 0.0)
PERIOD = 0.25


class SilentError(Exception):
    """Error whose text ends the process."""

    def __str__(self) -> str:
        raise SystemExit(3)


RAISED = {
    "SystemExit": SystemExit(3), "GeneratorExit": GeneratorExit(), "text": SilentError(),
    "RecursionError": RecursionError("deep"), "MemoryError": MemoryError(),
}
"""What foreign code raises; a KeyboardInterrupt may be of the user, where SIGINT raises one."""


def rolling(situation: Situation) -> Plan:
    return plan_of(situation, [PERIOD] * 2, np.array([[20.0, 0.0], [20.0, 0.0]]))


class Foreign(Given):
    """Strategy of the table, whose methods a test replaces."""

    error: BaseException | None = None
    fails_in = ""

    def __init__(self, *arguments: object) -> None:
        super().__init__(rolling)
        self.call("__init__")

    def call(self, name: str) -> None:
        if Foreign.error is not None and Foreign.fails_in == name:
            raise Foreign.error

    def plan(self, situation: Situation) -> Plan:
        self.call("plan")
        return super().plan(situation)

    def reset(self) -> None:
        self.call("reset")
        super().reset()

    def change(self, settings: ControllerSettings) -> None:
        self.call("change")

    def search_beside(self, worker: Worker) -> None:
        self.call("search_beside")

    @property
    def searches(self) -> bool:
        self.call("searches")
        return False

    def is_due(self, now: float) -> bool:
        self.call("is_due")
        return False


@pytest.fixture
def foreign(monkeypatch: pytest.MonkeyPatch) -> ControllerSettings:
    """Return settings that choose the strategy by the table."""
    monkeypatch.setitem(STRATEGIES, "foreign", StrategyEntry(f"{__name__}:Foreign"))
    monkeypatch.setattr(Foreign, "error", None)
    monkeypatch.setattr(Foreign, "fails_in", "")
    return ControllerSettings(strategy="foreign")


def begun(
    make: Callable[[Situation], Any] = rolling, floor: Floor | None = None,
    settings: ControllerSettings = SETTINGS,
) -> Controller:
    controller = Controller(settings, ROBOT, Given(make))
    controller.floor = floor
    return ready(controller)


def ready(controller: Controller) -> Controller:
    """Give a controller a goal and a pose."""
    controller.set_goal(GOAL)
    controller.observe(0.0, START)
    return controller


def fail(name: str, error: BaseException) -> None:
    Foreign.fails_in, Foreign.error = name, error


@pytest.mark.parametrize("error", RAISED)
@pytest.mark.parametrize("name", ["plan", "reset", "change", "searches", "is_due"])
def test_whatever_a_strategy_raises_is_counted_and_the_loop_goes_on(foreign, error, name) -> None:
    controller = ready(Controller(foreign, ROBOT, worker=InLine()))
    fail(name, RAISED[error])
    controller.change(replace(foreign, goal_tolerance=0.02))
    controller.enabled = False
    controller.enabled = True
    for time in (0.0, PERIOD):
        controller.observe(time + 0.01, START)
        controller.commit(controller.decide(time + 0.02), time + 0.02)
        assert not controller.planner.searches and not controller.planner.is_due(time)
    assert controller.failures > 0
    kind = "ForeignCodeError" if error in ("SystemExit", "GeneratorExit", "text") else error
    assert kind in controller.last_failure
    Foreign.error = None
    assert controller.decide(2.0 * PERIOD).mode is Kind.TRACKING


@pytest.mark.parametrize("error", sorted(set(RAISED) - {"MemoryError"}))
@pytest.mark.parametrize("name", ["__init__", "search_beside"])
def test_strategy_that_cannot_be_made_is_refused_and_the_one_in_force_stays(
    foreign, error, name
) -> None:
    in_force = ControllerSettings(strategy="paper")
    controller = Controller(in_force, ROBOT, worker=InLine())
    fail(name, RAISED[error])
    words = "'foreign', expected one that can be made"
    for take in (controller.prepare, controller.change):
        with pytest.raises(InvalidParameterError, match=words):
            take(foreign)
    assert ready(controller).decide(0.0).mode is Kind.TRACKING
    assert controller.failures == 0


def test_strategy_that_was_prepared_is_the_one_put_in_force(foreign) -> None:
    controller = Controller(ControllerSettings(strategy="paper"), ROBOT)
    controller.prepare(foreign)
    fail("__init__", SystemExit(3))  # no second one can be made
    controller.change(foreign)
    assert ready(controller).decide(0.0).mode is Kind.TRACKING


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        ("import sys; sys.exit(3)", "SystemExit '3'"),
        ("raise KeyboardInterrupt", "KeyboardInterrupt ''"),
        ("class", "SyntaxError"),
        ("def f(): f()\nf()", "RecursionError"),
    ],
)
def test_import_that_ends_the_process_is_refused(
    foreign, tmp_path, monkeypatch, source, cause
) -> None:
    (tmp_path / "ends_at_import.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(STRATEGIES, "foreign", StrategyEntry("ends_at_import:Own"))
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as in a worker: it is not the user's
    try:
        with pytest.raises(InvalidParameterError) as caught:
            Controller(foreign, ROBOT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert cause in str(caught.value) and "\n" not in str(caught.value)


def test_interrupt_of_the_user_is_raised() -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        called(interrupted)


class Other(Plan):
    """Plan with methods of its own."""


class OtherLeg(Leg):
    """Leg with methods of its own."""


class OtherHold(FirstOrderHold):
    """Hold with methods of its own."""


def many(situation: Situation) -> Plan:
    times = situation.time + np.linspace(0.0, 3.0, MOST_KNOTS + 1)
    return Plan(FirstOrderHold(times, np.zeros((times.size, 2))), situation.state[None, :])


WRONG = {
    "nothing": lambda now: None,
    "another plan": lambda now: Other(**vars(rolling(now))),
    "another hold": lambda now: replace(
        rolling(now), hold=OtherHold(rolling(now).hold.times, rolling(now).hold.speeds)
    ),
    "too many knots": many,
    "a row too many": lambda now: replace(rolling(now), states=np.zeros((4, STATE_SIZE))),
    "a flat array": lambda now: replace(rolling(now), states=np.zeros(STATE_SIZE)),
    "a generator": lambda now: replace(rolling(now), states=iter(int, 1)),
    "text": lambda now: replace(rolling(now), states="states"),
    "nan": lambda now: replace(rolling(now), states=np.full((1, STATE_SIZE), math.nan)),
}
WRONG_TYPES = {
    "the status": {"status": "solved"},
    "a time": {"until": "soon"},
    "the leg": {"leg": Goal(GOAL)},
    "another leg": {"leg": OtherLeg(Goal(GOAL))},
    "a goal": {"leg": Leg(None)},
    "the end of a leg": {"leg": Leg(Goal(GOAL), "through")},
    "the time left": {"leg": Leg(Goal(GOAL), LegEnd.THROUGH, time_left="a while")},
    "the time of an arrival": {"leg": Leg(Goal(GOAL, since="later"))},
    "how it was made": {"made": {"cost": 1.0}},
    "a cost": {"made": Made(cost="much")},
    "a count": {"made": Made(iterations=0.5)},
    "conditions": {"conditions": "given up"},
    "a list of conditions": {"conditions": [Kind.GIVEN_UP.conditions]},
    "a condition": {"conditions": ("given up",)},
    "a tuple": {"conditions": ((Kind.PLANNED, "rolls", ""),)},
    "a kind": {"conditions": (Condition("planned"),)},
    "a message": {"conditions": (Condition(Kind.PLANNED, b"bytes"),)},
}
"""Values of a plan's fields that are of other types."""


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_no_plan_counts_as_a_failure(wrong) -> None:
    controller = begun(WRONG[wrong])
    decision = controller.decide(0.0)
    assert decision.mode is Kind.FALLBACK and controller.failures == 1
    assert "\n" not in decision.plan.message and len(decision.plan.message) < 200


@pytest.mark.parametrize("values", WRONG_TYPES.values(), ids=WRONG_TYPES)
def test_field_of_another_type_is_refused_in_a_line_that_names_what_was_given(values) -> None:
    controller = begun(lambda now: replace(rolling(now), **values))
    assert controller.decide(0.0).mode is Kind.FALLBACK and controller.failures == 1
    assert len(controller.last_failure) < 200 and re.fullmatch(
        r"TypeError: plan: given (the \w+ .+, expected another type|\w+, expected \w+)",
        controller.last_failure,
    )


@pytest.mark.parametrize("name", [
    "state", "goal.pose", "goal.rate", "speeds", "in_force.speeds", "in_force.times",
    "plant.deviations", "covariance",
])
def test_arrays_of_a_situation_cannot_be_written_to(name) -> None:
    def writes(situation: Situation) -> Plan:
        attrgetter(name)(situation)[...] = 7.0
        return rolling(situation)

    controller = begun(writes, settings=NOISY)
    decision = controller.decide(0.0)
    assert decision.mode is Kind.FALLBACK
    assert "read-only" in controller.last_failure
    np.testing.assert_array_equal(decision.state[POSITION], START[POSITION])


def test_disturbance_and_floor_of_a_situation_cannot_be_written_to() -> None:
    refused = []

    def writes(situation: Situation) -> Plan:
        floor, disturbance = situation.floor, situation.disturbance
        for array in (
            floor.grid.occupied, floor.fine.occupied, floor.corner_distances, disturbance.slope,
            disturbance.imbalance, situation.in_force.speeds,
        ):
            try:
                array[...] = 0
            except ValueError as error:
                refused.append(str(error))
        return rolling(situation)

    controller = begun(floor=walled())
    controller.set_goal(NEAR)
    controller.commit(controller.decide(0.0), 0.0)
    controller.planner.strategy = Given(writes)
    controller.observe(0.2, START)
    controller.decide(PERIOD)
    assert len(refused) == 6


def test_plan_is_not_changed_by_what_the_strategy_writes_later() -> None:
    given = np.zeros((3, STATE_SIZE))

    def kept(situation: Situation) -> Plan:
        given[:] = situation.state
        return replace(rolling(situation), states=given[:])

    decision = begun(kept).decide(0.0)
    before = decision.plan.states.copy()
    given[:] = math.nan
    np.testing.assert_array_equal(decision.plan.states, before)


def walled() -> Floor:
    """Return a floor that ends 0.5 m from the sphere."""
    occupied = np.zeros((20, 20), dtype=bool)
    return Floor(Grid(occupied, 0.05, (-0.5, -0.5, 0.0)), ROBOT.shell_radius, 0.05)


NEAR = upright_state(-0.1, 0.0, 0.0)


def into_wall(situation: Situation) -> Plan:
    return plan_of(situation, [1.0] * 3, np.array([[0.0, 90.0]] * 3))


CLAIMS = {
    "clearance": {"clearance": 1.0},
    "infinite clearance": {"clearance": math.inf},
    "stop": {"status": PlanStatus.RAMP_TO_REST},
    "holding": {"status": PlanStatus.HOLDING},
    "saturated": {
        "status": PlanStatus.SATURATED, "states": np.append(START, np.zeros(3))[None, :]
    },
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_plan_into_a_wall_is_not_followed_whatever_it_says_of_itself(claim) -> None:
    floor = walled()
    controller = begun(lambda now: replace(into_wall(now), **CLAIMS[claim]), floor)
    controller.set_goal(NEAR)
    decision = controller.decide(0.0)
    assert controller.failures == 0, controller.last_failure
    assert not decision.plan.hold.speeds.any()
    hold = controller.commit(decision, 0.0)
    assert hold is None or not hold.speeds.any()


@pytest.mark.parametrize("ahead", [0.0, 1.0])
def test_plan_begins_at_the_present_and_keeps_the_limits_before_it_is_certified(ahead) -> None:
    def wild(situation: Situation) -> Plan:
        plan = rolling(situation)
        times = plan.hold.times + ahead
        return replace(plan, hold=FirstOrderHold(times, np.full((times.size, 2), 1e6)))

    hold = begun(wild).decide(0.0).plan.hold
    assert hold.start == 0.0 and not hold.speeds[0].any()
    assert np.abs(hold.speeds).max() <= ROBOT.max_rotor_speed
    assert largest_slope(hold) <= ROBOT.max_rotor_acceleration * (1.0 + 1e-9)


def test_text_of_a_plan_is_one_printable_line() -> None:
    text = "a\nb\x1b[31m" + 10_000 * "x"
    told = tuple(Condition(kind, text) for kind in (Kind.PLANNED, Kind.GIVEN_UP))
    plan = begun(lambda now: replace(rolling(now), conditions=told)).decide(0.0).plan
    for line in (plan.message, plan.given_up):
        assert line.isprintable() and len(line) <= 600


def test_module_that_raises_for_a_missing_name_is_refused(foreign, monkeypatch) -> None:
    module = types.ModuleType("ends_when_asked")

    def ends(name: str) -> None:
        raise SystemExit(3)

    module.__getattr__ = ends  # type: ignore[method-assign]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(STRATEGIES, "foreign", StrategyEntry("ends_when_asked:Own"))
    with pytest.raises(InvalidParameterError, match="can be imported"):
        Controller(foreign, ROBOT)
