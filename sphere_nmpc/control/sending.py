# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is sent to the rotors: of a decision's plan, or of the loop's own where there is none.

Each command joins the one in force, within the limits of the drives, and ends at rest.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.planner import Planner
from sphere_nmpc.control.timing import MOST_AHEAD
from sphere_nmpc.estimation.rotor_history import NEGLIGIBLE, RotorHistory
from sphere_nmpc.model.first_order_hold import SHORTEST, FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, STATE_SIZE, Vector
from sphere_nmpc.model.torque import heat_and_energy, torques
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.clearance import Margin, clearance_of
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import stop

REACH = 3.0
"""Time after which a command that is not renewed stops [s]."""


class Commands:
    """Owner of the holds that were sent, and of those that can follow.

    Times are control times [s].

    Parameters
    ----------
    robot : RobotParameters
        Robot with the limits of its drives.
    record : callable
        Records an error.
    """

    def __init__(self, robot: RobotParameters, record: Callable[[Exception], object]) -> None:
        self._robot, self._record = robot, record
        self.rotors = RotorHistory(robot.max_rotor_acceleration)
        """History of the holds sent."""
        self._begun: FirstOrderHold | None = None
        self._stops = False
        self._newest: FirstOrderHold | None = None
        self._renewed_at = -math.inf

    def in_force(self, time: float) -> FirstOrderHold:
        """Return the hold in force from `time` on; before the first one rest."""
        newest = self.rotors.newest
        hold = FirstOrderHold.constant(time, np.zeros(INPUT_SIZE)) if newest is None else newest
        return hold.starting_at(time, self.rotors.at(time))

    def stopping(self, time: float) -> FirstOrderHold:
        """Return the hold from `time` on that comes to rest on the path of the one in force."""
        in_force = self.in_force(time)
        if self._stops and self._newest is not None and self._newest is self.rotors.newest:
            return in_force
        return in_force.stop(time, self._robot.max_rotor_acceleration)

    def rest_of(self, hold: FirstOrderHold, time: float) -> FirstOrderHold | None:
        """Return the rest of the newest command from `time` on if it follows a hold, else None.

        It is None as well where the stop at its end has come near, or its end within the shortest
        interval.
        """
        newest = self.rotors.newest
        if hold is not self._begun or newest is None or newest is not self._newest:
            return None
        if time > self._renewed_at or 0.0 < newest.end - time <= SHORTEST:
            return None
        time = round(time * NANOSECONDS) / NANOSECONDS  # on the line between two knots
        return newest.starting_at(time, newest.at(time), SHORTEST)

    def earliest(self, now: float) -> float:
        """Return the time at which a command can start: the clock may be slightly late."""
        newest = self.rotors.newest
        is_near = newest is not None and now <= newest.start <= now + MOST_AHEAD
        return newest.start if newest is not None and is_near else now

    def joined(
        self, hold: FirstOrderHold, start: float, period: float, reach: float = REACH
    ) -> FirstOrderHold:
        """Return the hold from the speeds in force at `start` on, within all limits, to rest.

        It stops on its path `reach` [s] or two control periods `period` [s] later: a robot that
        gets no further command must not roll on.
        """
        last, limit = start + max(reach, 2.0 * period), self._robot.max_rotor_acceleration
        led = self.rotors.leading_to(hold, start)
        if led.end > last:
            led = led.stop(last, limit)
        limited = led.in_nanoseconds().limited(self._robot.max_rotor_speed, limit)
        return limited.stop(limited.end, limit)

    def send(
        self, decision: Decision, hold: FirstOrderHold, now: float, planner: Planner,
        settings: ControllerSettings,
    ) -> FirstOrderHold | None:
        """Record and return what is sent at `now` of a decision's hold; None if it is nothing.

        The planner has the plan in force, which is none any more where something else is sent.
        """
        start = self.earliest(now)
        sent = self.rest_of(hold, start)
        if sent is None:
            period, planned = settings.control_period, planner.in_force
            late = start - decision.plan.hold.start > NEGLIGIBLE * settings.units.time
            if late and planned is not None and planned.is_certified:
                sent = self._clear(planned.situation, hold, start, period)
                planner.in_force = None  # it is not what is followed
            else:
                sent = self.joined(hold, start, period)
            stops = not decision.solved and decision.mode is not Kind.FALLBACK
            if stops and not sent.speeds.any() and not self.rotors.moves_after(start):
                return None
            self._begun, self._stops = hold, stops
            self._renewed_at = sent.start + 0.5 * REACH
        self.rotors.record(sent)
        self._newest = sent
        return sent

    def _clear(
        self, situation: Situation, hold: FirstOrderHold, start: float, period: float
    ) -> FirstOrderHold:
        """Return what is sent of a plan `hold` that begins late, at `start` [s].

        It begins in another state than was planned, so that its motion is another one, unless the
        sphere rests until then and the plan is as late. Where neither is certified it is sent up
        to a stop, as the next plan, after `period` [s], corrects that; where that is not, only a
        stop. All are joined to the speeds in force.
        """
        durations, speeds = self.rotors.pieces(situation.time, start)
        times, late = np.append(0.0, np.cumsum(durations)), start - hold.start
        for sent in (
            self.joined(hold, start, period),
            self.joined(hold.delayed(late), start, period),
            self.joined(hold, start, period, late + period),
        ):
            motion = FirstOrderHold(
                np.append(times, sent.times[1:] - situation.time),
                np.vstack((speeds, sent.speeds[1:])),
            )
            if not math.isnan(clearance_of(situation, motion, Margin.SENT)):
                return sent
        situation = replace(situation, time=start, in_force=self.in_force(start))
        return self.joined(stop(situation, self._robot, "late").hold, start, period)

    def stop(self, time: float, mode: Kind, state: Vector | None = None) -> Plan:
        """Return the plan that comes to rest on the path of the hold in force."""
        hold = self._hold_or_rest(self.stopping, time)
        return _unplanned(PlanStatus.RAMP_TO_REST, hold, state, mode.value)

    def fallback(
        self, time: float, state: Vector | None, message: str, is_on_floor: bool
    ) -> Plan:
        """Return the rest of the hold in force; on a floor, which may be another one, a stop."""
        rest = self.stopping if is_on_floor else self.in_force
        hold = self._hold_or_rest(rest, time)
        return _unplanned(PlanStatus.FALLBACK, hold, state, message)

    def _hold_or_rest(
        self, command: Callable[[float], FirstOrderHold], time: float
    ) -> FirstOrderHold:
        """Return the command from `time` on; where it fails rest, to which `send` ramps."""
        try:
            return command(time)
        except Exception as error:
            self._record(error)
            return FirstOrderHold.constant(time, np.zeros(INPUT_SIZE))

    def effort(
        self, start: float, end: float, pose: Vector, constants: LumpedConstants
    ) -> Vector:
        """Return what the commands from `start` to `end` took, see `heat_and_energy`.

        It is that at a pose, shape (6,): in half a second the sphere turns by so little that this
        changes the heat by 1 %.
        """
        durations, speeds = self.rotors.pieces(start, end)
        states = np.tile(pose, (durations.size + 1, 1))
        hold = FirstOrderHold(np.append(0.0, np.cumsum(durations)), speeds)
        each = torques(states, hold, constants, self._robot.rotor_axial_inertia)
        return heat_and_energy(durations, speeds, *each)


def _unplanned(
    status: PlanStatus, hold: FirstOrderHold, state: Vector | None, message: str
) -> Plan:
    states = np.empty((0, STATE_SIZE)) if state is None else state[None, :]
    return Plan(hold, states, status, conditions=(Condition(Kind.PLANNED, message),))
