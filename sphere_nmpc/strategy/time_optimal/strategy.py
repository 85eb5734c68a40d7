# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time-optimal control with a shrinking horizon: plan once, arrive on time, then hold.

At a new goal the earliest arrival that a search finds is planned. At each later sample the rest
of the plan is solved again from the measured state, with one interval less; if it can no longer
arrive on time, it arrives a little later. At the goal the rotors rest; small errors that rolling
alone can undo are undone by the paper's problem with a heavier input weight, larger ones by a new
plan. ``docs/strategy.md`` has the stability argument.
"""

import dataclasses
import time

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, nearer_sign, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.arrival import Arrival, ArrivalSolver, Effort
from sphere_nmpc.strategy.time_optimal.grid import to_first_knot
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.stages import Stages, led_on

_PRECISE = Effort(max_iterations=40, max_step=0.05, miss=1e-6)
_ON_TIME = 1e-4
"""Predicted miss up to which a plan counts as arriving."""
_DELAYS = (1.0, 1.01, 1.02, 1.04, 1.08, 1.16, 1.32)
"""Stretches of the time left that are tried before planning anew."""
_LONG_DELAYS = (1.6, 2.0, 2.5)
"""Further stretches of a new plan, which near the goal may be short of what is exact."""
_DEAD_BAND = (2e-3, 6e-2)
"""Least and largest error at which the rotors rest; between them it follows the noise."""
_NOISE_IN_BAND = 50.0
"""Standard deviations of the noise in the dead band."""
_UNCERTAINTY_IN_BAND = 3.0
"""Standard deviations of the state's own error in the dead band: no arrival is more exact."""
_WIDER = 1.5
"""Factor on that part once at rest, where more poses show how exact the arrival was."""
_LEFT_ALONE = 8e-3
"""Error up to which one at rest stays there: the way to less leads through more than 1e-2."""
_LOCAL_INPUT_WEIGHT = 100.0
"""Factor on the paper's input weight near the goal: only what rolling itself undoes."""
_LATER_SHARE = 10
"""Part of the planning effort that each later sample spends on an earlier arrival."""
_END, _VERY_END = 4.5, 1.5
"""Periods before the arrival in which noise can no longer be undone in full, or hardly at all."""
_MUCH_LATER = 1.03
"""Stretch of the time left beyond which the whole effort is spent again."""
_TOO_NEAR = 1.0
"""Time left [s] from which on the arrival stays as it is."""
_OVER = 1e-3
"""Time left [s] at which a plan counts as done."""
_LEAST_SEARCH = 5e-3
"""Wall time [s] below which looking for an earlier arrival is not worth beginning."""
_PATIENCE = 0.5
"""Part of the sample period for which a search from rest may go on over several ticks."""
_SLIPPING = 0.01
"""Noise [m, -] at which a new plan takes the floor to be slippery ..."""
_GENTLE = 0.45
"""... and the share of the drives' acceleration that it then uses. Friction holds what the model
cannot tell; on a floor of 0.15 to 0.2 a sphere that insists on all of it never arrives."""
_AT_REST = 1e-3
"""Rotor speeds below this [rad/s] count as rest."""


class TimeOptimalStrategy:
    """See `sphere_nmpc.strategy.contract.Strategy`.

    Parameters
    ----------
    settings : ControllerSettings
        Sample period, planning effort, seed.
    robot : RobotParameters
        Limits of the drives.
    """

    def __init__(self, settings: ControllerSettings, robot: RobotParameters) -> None:
        self._robot = self._drives = robot
        self._gentle = dataclasses.replace(
            robot, max_rotor_acceleration=_GENTLE * robot.max_rotor_acceleration
        )
        self._period = settings.period
        self._solver = ArrivalSolver(robot, self._period, _PRECISE)
        self._local = PaperStrategy(_local_settings(settings), robot, _LOCAL_INPUT_WEIGHT)
        self._settings = settings
        self._stages = Stages()
        self._plans = 0
        self.reset()

    def change(self, settings: ControllerSettings) -> None:
        """Use another planning effort and other weights; the plan is kept, a search goes on."""
        self._settings = settings
        self._local.change(_local_settings(settings))

    def reset(self) -> None:
        """Forget the plan; the next sample plans anew."""
        self._arrival: Arrival | None = None
        self._planned_at = 0.0
        self._origin: float | None = None
        self._holding = False
        self._leaving = 0.0
        self._unspent = 0
        self._strict = False
        self._begun: tuple[float, ArrivalSearch] | None = None
        self._stages.reset()
        self._local.reset()

    def plan(self, situation: Situation) -> Plan:
        """Go on with the plan, make a new one, or rest at the goal."""
        began = time.perf_counter()
        deadline = began + situation.time_budget
        if self._origin is None:
            self._origin = situation.time
        situation = self._within_reach(situation)
        vague = _UNCERTAINTY_IN_BAND * situation.uncertainty
        band = float(np.clip(max(_NOISE_IN_BAND * situation.noise, vague), *_DEAD_BAND))
        arrival = self._rest_of_plan(situation, band, deadline)
        if arrival is None:
            error = state_error(situation.state, situation.goal)
            at_rest = bool(np.all(np.abs(situation.input_in_force) < _AT_REST))
            if not self._holding:
                self._leaving = max(_LEFT_ALONE, _WIDER * vague)
                self._holding = at_rest and error < band
            elif error >= max(band, self._leaving):
                self._holding = False
            if self._holding:
                return self._hold(situation, error)
            self._local.reset()
            arrival = self._search(situation, at_rest, deadline)
        if arrival is None:
            return self._keep_still(situation, began)
        self._arrival, self._planned_at = arrival, situation.time
        late = arrival.miss > _ON_TIME
        return Plan(
            PlanStatus.BEST_SO_FAR if late else PlanStatus.SOLVED,
            arrival.hold.delayed(situation.time),
            arrival.states,
            arrival=situation.time + arrival.duration,
            cost=arrival.miss**2,
            iterations=arrival.iterations,
            kkt_residual=arrival.kkt_residual,
            solve_time=time.perf_counter() - began,
            message=f"arrives in {arrival.duration:.2f} s, {arrival.miss:.1e} off",
        )

    def _within_reach(self, situation: Situation) -> Situation:
        """Return the situation with a goal near enough to plan for, and lead the plan there."""
        arrival, elapsed = self._arrival, situation.time - self._planned_at
        left = 0.0 if arrival is None else arrival.duration - elapsed
        staged, fresh, is_onward = self._stages.aim(situation, left)
        if fresh:
            self._arrival = self._begun = None
            if arrival is not None and is_onward:
                rest = arrival.hold.starting_at(elapsed, arrival.hold.at(elapsed))
                self._arrival = led_on(arrival, rest.delayed(-elapsed), staged)
                self._planned_at = situation.time
        return staged

    def _rest_of_plan(
        self, situation: Situation, band: float, deadline: float
    ) -> Arrival | None:
        """Solve the rest of the plan again, later if it must be; None if there is none."""
        if self._arrival is None:
            return None
        elapsed = situation.time - self._planned_at
        left = self._arrival.duration - elapsed
        if left < _OVER:
            self._arrival = None
            return None
        plan = self._arrival.hold.starting_at(elapsed, self._arrival.hold.at(elapsed))
        plan = plan.delayed(-elapsed)
        goal = self._arrival.goal
        first = self._first_knot(situation.time, anew=False)
        best: Arrival | None = None
        for stretch in _DELAYS:
            if best is not None and time.perf_counter() > deadline:
                return best
            arrival = self._solver.solve(
                situation, goal, stretch * left, plan, first
            )
            if arrival.miss <= _ON_TIME:
                # Much later than planned: the robot is not what it seemed, plan with what it is.
                share = 1 if stretch > _MUCH_LATER else _LATER_SHARE
                work = self._settings.planning_effort // share
                return self._earlier(situation, arrival, work, deadline)
            if best is None or arrival.miss < 0.5 * best.miss:
                best = arrival
            if best.miss < _tolerated(left / self._period) * band:
                # Too few knots are left to undo what noise did since: being late gains nothing.
                return best
        self._arrival = None
        return None

    def _earlier(
        self, situation: Situation, arrival: Arrival, work: int, deadline: float
    ) -> Arrival:
        """Use what is left of the sample to look for an earlier arrival than the one in hand."""
        first = self._first_knot(situation.time, anew=False)
        tick = self._settings.control_period
        between_knots = tick < self._period and first < self._period - 0.5 * tick
        short = deadline - time.perf_counter() < _LEAST_SEARCH
        if arrival.duration < _TOO_NEAR or work == 0 or between_knots or short:
            return arrival
        self._plans += 1
        # What a first search had no time for is made up for here.
        work = max(work, self._unspent)
        search = ArrivalSearch(self._drives, self._period, situation, first, self._plans)
        search.adopt(arrival)
        found = search.improve(work, deadline)
        self._unspent = max(0, self._unspent - search.work)
        if found is None or found is arrival:
            return arrival
        precise = self._solver.solve(
            situation, found.goal, found.duration, found.hold, first
        )
        return precise if precise.miss <= _ON_TIME else arrival

    def _search(
        self, situation: Situation, at_rest: bool, deadline: float
    ) -> Arrival | None:
        """Plan anew and solve the best arrival precisely; None while the search goes on.

        At a high control rate no tick is long enough: a search from rest, which is as good a
        little later, is then gone on with at the next ones.
        """
        begun, self._begun = self._begun, None
        if begun is None or not at_rest:
            self._drives = self._gentle if situation.noise > _SLIPPING else self._robot
            self._solver = ArrivalSolver(self._drives, self._period, _PRECISE)
            begun = situation.time, self._new_search(situation)
        since, search = begun
        effort, tick = self._settings.planning_effort, self._settings.control_period
        found = search.improve(effort - search.work, deadline)
        self._unspent = max(0, effort - search.work)
        waited = situation.time - since
        if at_rest and self._unspent and waited + tick < _PATIENCE * self._period:
            self._begun = begun
            return None
        if found is None:
            return None
        if waited > 0.0:
            self._origin = situation.time
        first = self._first_knot(situation.time, anew=True)
        for stretch in _DELAYS + _LONG_DELAYS:
            arrival = self._solver.solve(
                situation, found.goal, stretch * found.duration, found.hold, first
            )
            if arrival.miss <= _ON_TIME:
                self._strict = False
                return arrival
        # The next search would find the same again.
        self._strict = True
        return None

    def _new_search(self, situation: Situation) -> ArrivalSearch:
        self._plans += 1
        signed = dataclasses.replace(situation, goal=nearer_sign(situation.goal, situation.state))
        first = self._first_knot(situation.time, anew=True)
        return ArrivalSearch(
            self._drives, self._period, signed, first, self._plans, self._strict
        )

    def _first_knot(self, now: float, anew: bool) -> float:
        origin = now if self._origin is None else self._origin
        return to_first_knot(now, origin, self._period, anew)

    def _hold(self, situation: Situation, error: float) -> Plan:
        """Rest at the goal, or undo what rolling alone can undo while there is noise."""
        if error > _DEAD_BAND[0] or situation.noise > 0.1 * _DEAD_BAND[0]:
            goal = nearer_sign(situation.goal, situation.state)
            local = self._local.plan(dataclasses.replace(situation, goal=goal))
            return dataclasses.replace(local, status=PlanStatus.HOLDING)
        return self._still(situation, PlanStatus.HOLDING, f"at the goal, {error:.1e} off")

    def _keep_still(self, situation: Situation, began: float) -> Plan:
        """Nothing found yet: come to rest and go on searching at the next sample."""
        plan = self._still(situation, PlanStatus.RAMP_TO_REST, "no arrival found yet")
        return dataclasses.replace(plan, solve_time=time.perf_counter() - began)

    def _still(self, situation: Situation, status: PlanStatus, message: str) -> Plan:
        acceleration = self._robot.max_rotor_acceleration
        hold = FirstOrderHold.ramp_to_rest(
            situation.time, situation.input_in_force, acceleration
        )
        states: Vector = situation.state[None, :]
        return Plan(status, hold, states, message=message)


def _local_settings(settings: ControllerSettings) -> ControllerSettings:
    """Return the settings of the paper's problem near the goal."""
    return dataclasses.replace(settings, horizon=4)


def _tolerated(periods_left: float) -> float:
    """Return the miss, over the dead band, that is put up with this near the arrival."""
    if periods_left >= _END:
        return 0.0
    return 0.2 if periods_left >= _VERY_END else 0.7
