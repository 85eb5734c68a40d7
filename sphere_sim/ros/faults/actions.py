# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What brings each fault about, and what ends it."""

from typing import Any, Protocol

from std_srvs.srv import SetBool, Trigger

from sphere_sim.faults.catalogue import Fault
from sphere_sim.faults.pose_stream import NANOSECONDS, make_disturbance
from sphere_sim.ros.faults.on_goals import BadGoals
from sphere_sim.ros.faults.on_processes import (
    BadStart,
    DiskFull,
    Hogs,
    Kill,
    Rival,
    Throttle,
)
from sphere_sim.ros.faults.session import FaultSession, SessionError


class Action(Protocol):
    """Something that goes wrong for a while."""

    def begin(self, session: FaultSession) -> None:
        """Let it go wrong."""

    def keep_on(self, session: FaultSession) -> None:
        """Do what has to be done again and again meanwhile."""

    def end(self, session: FaultSession) -> None:
        """Let all be well again."""


class Lasting:
    """A fault that needs nothing to be done while it lasts."""

    def keep_on(self, session: FaultSession) -> None:
        """Do nothing."""


class SpoiltPoses(Lasting):
    """Poses go wrong on their way."""

    def __init__(self, **options: Any) -> None:
        self._disturbance = make_disturbance(options)

    def begin(self, session: FaultSession) -> None:
        """Spoil."""
        session.proxy.stream.disturbances.append(self._disturbance)

    def end(self, session: FaultSession) -> None:
        """Spoil no more."""
        session.proxy.stream.disturbances.remove(self._disturbance)


class Pause(Lasting):
    """Simulated time stands still."""

    def begin(self, session: FaultSession) -> None:
        """Stop time."""
        session.ask("simulator/pause", SetBool.Request(data=True))

    def end(self, session: FaultSession) -> None:
        """Let it go on."""
        session.ask("simulator/pause", SetBool.Request(data=False))


class ClockLost(Lasting):
    """The controller hears poses, but no clock."""

    def begin(self, session: FaultSession) -> None:
        """Hold the clock back."""
        session.proxy.clock_passes = False

    def end(self, session: FaultSession) -> None:
        """Let it pass."""
        session.proxy.clock_passes = True


class ClockBack(Lasting):
    """The time of the world steps back, for good."""

    def __init__(self, by: float) -> None:
        self._by = round(by * NANOSECONDS)

    def begin(self, session: FaultSession) -> None:
        """Step back."""
        session.proxy.shift -= self._by
        session.monitor.limits.forget()

    def end(self, session: FaultSession) -> None:
        """Stay there: a step forward would be another fault."""


class Pace(Lasting):
    """Time runs at another pace."""

    def __init__(self, factor: float) -> None:
        self._factor = factor

    def begin(self, session: FaultSession) -> None:
        """Change the pace."""
        _set_pace(session, self._factor)

    def end(self, session: FaultSession) -> None:
        """Go back to the pace of the campaign."""
        _set_pace(session, session.settings.pace)


class BadSolver(Lasting):
    """The solver goes wrong."""

    def __init__(self, mode: str) -> None:
        self._mode = mode

    def begin(self, session: FaultSession) -> None:
        """Say what goes wrong."""
        session.solver_file.write_text(self._mode)

    def end(self, session: FaultSession) -> None:
        """Say that nothing does."""
        session.solver_file.write_text("")


class BadLiveParameters(Lasting):
    """Somebody sets parameters to what they cannot be."""

    _WRONG = (
        ("controller", "pose_timeout", -1.0), ("controller", "pose_timeout", float("nan")),
        ("controller", "max_iterations", "many"), ("controller", "strategy", "none"),
        ("controller", "robot__max_rotor_speed", 1e9), ("controller", "no_such_thing", 1),
        ("simulator", "real_time_factor", -1.0), ("simulator", "process_noise", float("inf")),
        ("simulator", "seed", "seven"),
    )

    def begin(self, session: FaultSession) -> None:
        """Set them; each has to be refused, with a reason."""
        for node, name, value in self._WRONG:
            (result,) = session.set_parameters(node, **{name: value})
            if result.successful or not result.reason:
                raise SessionError(f"{node} took {name} = {value!r} without a word")
            session.monitor.said.append(f"refused live: {result.reason}")

    def end(self, session: FaultSession) -> None:
        """Nothing has changed that would have to be changed back."""


class StoppedRecording(DiskFull):
    """The disk is full, and once it is not somebody starts the recorder again."""

    def end(self, session: FaultSession) -> None:
        """Give the disk back and record anew."""
        super().end(session)
        answer = session.ask("recorder/start", Trigger.Request())
        if not answer.success and "already" not in answer.message:
            raise SessionError(f"the recorder does not start again: {answer.message}")


_ACTIONS: dict[str, Any] = {
    "pose": SpoiltPoses,
    "goals": BadGoals,
    "pause": Pause,
    "clock_lost": ClockLost,
    "clock_back": ClockBack,
    "pace": Pace,
    "kill": Kill,
    "solver": BadSolver,
    "throttle": Throttle,
    "hogs": Hogs,
    "disk_full": StoppedRecording,
    "rival": Rival,
    "bad_start": BadStart,
    "bad_live": BadLiveParameters,
}


def action_of(fault: Fault) -> Action:
    """Return what brings a fault about."""
    action: Action = _ACTIONS[fault.action](**fault.options)
    return action


def _set_pace(session: FaultSession, factor: float) -> None:
    (result,) = session.set_parameters("simulator", real_time_factor=factor)
    if not result.successful:
        raise SessionError(f"the pace cannot be {factor:g}: {result.reason}")
