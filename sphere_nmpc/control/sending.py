# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is sent to the rotors: of a decision's plan, or of the loop's own where there is none."""

from collections.abc import Callable

import numpy as np

from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.keeping_clear import clear_command
from sphere_nmpc.control.link import Commands
from sphere_nmpc.control.planner import Planner
from sphere_nmpc.estimation.rotor_history import NEGLIGIBLE
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, STATE_SIZE, Vector
from sphere_nmpc.model.torque import heat_and_energy, torques
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.plan import Plan, PlanStatus


class Sending:
    """Owner of the commands sent.

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
        self.commands = Commands(robot)
        """Holds that were sent."""

    def send(
        self, decision: Decision, hold: FirstOrderHold, now: float, planner: Planner,
        settings: ControllerSettings,
    ) -> FirstOrderHold | None:
        """Record and return what is sent at `now` of a decision's hold; None if it is nothing.

        The planner has the plan in force, which is none any more where something else is sent.
        """
        commands = self.commands
        start = commands.earliest(now)
        sent = commands.rest_of(hold, start)
        if sent is None:
            period, planned = settings.control_period, planner.in_force
            late = start - decision.plan.hold.start > NEGLIGIBLE * settings.units.time
            if late and planned is not None and planned.is_certified:
                sent = clear_command(
                    planned.situation, hold, commands, start, period, self._robot
                )
                planner.in_force = None  # it is not what is followed
            else:
                sent = commands.joined(hold, start, period)
            stops = not decision.solved and decision.mode is not Kind.FALLBACK
            if stops and not sent.speeds.any() and not commands.rotors.moves_after(start):
                return None
            commands.begin(hold, sent, stops)
        commands.record(sent)
        return sent

    def stop(self, time: float, mode: Kind, state: Vector | None = None) -> Plan:
        """Return the plan that comes to rest on the path of the hold in force."""
        hold = self._hold_or_rest(self.commands.stop, time)
        return _unplanned(PlanStatus.RAMP_TO_REST, hold, state, mode.value)

    def fallback(
        self, time: float, state: Vector | None, message: str, is_on_floor: bool
    ) -> Plan:
        """Return the rest of the hold in force; on a floor, which may be another one, a stop."""
        rest = self.commands.stop if is_on_floor else self.commands.in_force
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
        durations, speeds = self.commands.rotors.pieces(start, end)
        states = np.tile(pose, (durations.size + 1, 1))
        hold = FirstOrderHold(np.append(0.0, np.cumsum(durations)), speeds)
        each = torques(states, hold, constants, self._robot.rotor_axial_inertia)
        return heat_and_energy(durations, speeds, *each)


def _unplanned(
    status: PlanStatus, hold: FirstOrderHold, state: Vector | None, message: str
) -> Plan:
    states = np.empty((0, STATE_SIZE)) if state is None else state[None, :]
    return Plan(status, hold, states, conditions=(Condition(Kind.PLANNED, message),))
