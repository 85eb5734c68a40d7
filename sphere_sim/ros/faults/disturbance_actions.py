# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Disturbances of the sphere itself, which leave it with momentum: a push, a tilted floor."""

import math

import numpy as np

from sphere_nmpc.model.drift import GRAVITY
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.ros.faults.action import Action
from sphere_sim.ros.faults.fault_session import FaultSession, SessionError


class Push(Action):
    """Push in a random direction.

    Parameters
    ----------
    impulse : float
        Its size [N s].
    """

    def __init__(self, impulse: float) -> None:
        self._size = impulse

    def begin(self, session: FaultSession) -> None:
        """Push the sphere."""
        self._impulse = self._size * _direction(session.rng.uniform(-math.pi, math.pi))
        session.push(self._impulse)

    def end(self, session: FaultSession) -> None:
        """Do nothing: the momentum stays."""

    def clear(self, session: FaultSession) -> None:
        """Push it back, so that the next trial begins without momentum."""
        session.push(-self._impulse)


class Tilt(Action):
    """Inclination of the floor in a random direction.

    Parameters
    ----------
    slope : float
        Inclination [rad].
    """

    def __init__(self, slope: float) -> None:
        self._slope = slope

    def begin(self, session: FaultSession) -> None:
        """Tilt the floor."""
        self._angle = session.rng.uniform(-math.pi, math.pi)
        _set_floor(session, self._slope, self._angle)
        self._began = session.monitor.time

    def end(self, session: FaultSession) -> None:
        """Level the floor; the momentum stays."""
        _set_floor(session, 0.0, 0.0)
        self._ended = session.monitor.time

    def clear(self, session: FaultSession) -> None:
        """Push the sphere uphill by as much as gravity has given it."""
        force = RobotParameters().total_mass * GRAVITY * math.sin(self._slope)
        session.push(-force * (self._ended - self._began) * _direction(self._angle))


def _direction(angle: float) -> Vector:
    return np.array([math.cos(angle), math.sin(angle)])


def _set_floor(session: FaultSession, slope: float, direction: float) -> None:
    results = session.set_parameters("simulator", slope=slope, slope_direction=direction)
    if not all(result.successful for result in results):
        raise SessionError(f"slope {slope:g} was refused: {[it.reason for it in results]}")
