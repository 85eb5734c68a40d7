# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The actions that begin and end each fault of the catalogue."""

from typing import Any

from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.faults.catalogue import Fault
from sphere_sim.faults.pose_stream import make_disturbance
from sphere_sim.ros.faults.action import Action
from sphere_sim.ros.faults.disturbance_actions import Push, Tilt
from sphere_sim.ros.faults.fault_session import FaultSession, SessionError
from sphere_sim.ros.faults.goal_actions import BadGoals
from sphere_sim.ros.faults.process_actions import (
    BadStart,
    DiskFull,
    Hogs,
    Kill,
    SecondController,
    Stop,
    Throttle,
)
from sphere_sim.ros.faults.second_poses import SecondPoses
from sphere_sim.ros.faults.worker_actions import SignalWorker


class DisturbedPoses(Action):
    """Disturbance of the poses between simulator and controller."""

    def __init__(self, **options: Any) -> None:
        self._disturbance = make_disturbance(options)

    def begin(self, session: FaultSession) -> None:
        """Add the disturbance."""
        session.proxy.stream.disturbances.append(self._disturbance)

    def end(self, session: FaultSession) -> None:
        """Remove the disturbance."""
        session.proxy.stream.disturbances.remove(self._disturbance)


class Pause(Action):
    """Pause of simulated time."""

    def begin(self, session: FaultSession) -> None:
        """Pause the simulator."""
        session.call("simulator/pause", SetBool.Request(data=True))

    def end(self, session: FaultSession) -> None:
        """Resume it."""
        session.call("simulator/pause", SetBool.Request(data=False))


class Loss(Action):
    """Loss of poses, clock or commands between simulator and controller.

    Parameters
    ----------
    of : tuple of str
        What is lost: poses, clock, commands.
    """

    def __init__(self, of: tuple[str, ...]) -> None:
        self._of = of

    def begin(self, session: FaultSession) -> None:
        """Stop forwarding it."""
        session.proxy.lost.update(self._of)

    def end(self, session: FaultSession) -> None:
        """Forward it again."""
        session.proxy.lost.difference_update(self._of)


class ClockBack(Action):
    """Permanent jump of simulated time into the past."""

    def __init__(self, by: float) -> None:
        self._by = round(by * NANOSECONDS)

    def begin(self, session: FaultSession) -> None:
        """Shift all stamps back."""
        session.proxy.shift -= self._by
        session.monitor.limits.restart()

    def end(self, session: FaultSession) -> None:
        """Keep the shift: a jump forward would be another fault."""


class Pace(Action):
    """Another real-time factor."""

    def __init__(self, factor: float) -> None:
        self._factor = factor

    def begin(self, session: FaultSession) -> None:
        """Change the factor."""
        _set_pace(session, self._factor)

    def end(self, session: FaultSession) -> None:
        """Set the factor of the campaign again."""
        _set_pace(session, session.settings.pace)


class BadSolver(Action):
    """Failure of the solver in the given mode, see `BadStrategy`."""

    def __init__(self, mode: str) -> None:
        self._mode = mode

    def begin(self, session: FaultSession) -> None:
        """Write the failure mode to the file that the strategy reads."""
        session.solver_file.write_text(self._mode)

    def end(self, session: FaultSession) -> None:
        """Clear the file."""
        session.solver_file.write_text("")


class BadLiveParameters(Action):
    """Invalid parameters that are set while the nodes run."""

    _WRONG = (
        ("controller", "pose_timeout", -1.0), ("controller", "pose_timeout", float("nan")),
        ("controller", "max_iterations", "many"), ("controller", "strategy", "none"),
        ("controller", "robot__max_rotor_speed", 1e9), ("controller", "no_such_thing", 1),
        ("simulator", "real_time_factor", -1.0), ("simulator", "process_noise", float("inf")),
        ("simulator", "seed", "seven"),
    )

    def begin(self, session: FaultSession) -> None:
        """Set them; each has to be refused with a reason."""
        for node, name, value in self._WRONG:
            (result,) = session.set_parameters(node, **{name: value})
            if result.successful or not result.reason:
                raise SessionError(f"{node} did not refuse {name} = {value!r} with a reason")
            session.monitor.messages.append(f"refused live: {result.reason}")

    def end(self, session: FaultSession) -> None:
        """Do nothing: no parameter has changed."""


class StoppedRecording(DiskFull):
    """Full disk, followed by a new recording once there is space again."""

    def end(self, session: FaultSession) -> None:
        """Remove the limit and start a new recording."""
        super().end(session)
        response = session.call("recorder/start", Trigger.Request())
        if not response.success and "already" not in response.message:
            raise SessionError(f"the recorder does not start again: {response.message}")


_ACTIONS: dict[str, Any] = {
    "pose": DisturbedPoses,
    "goals": BadGoals,
    "pause": Pause,
    "loss": Loss,
    "clock_back": ClockBack,
    "pace": Pace,
    "kill": Kill,
    "stop": Stop,
    "signal_worker": SignalWorker,
    "solver": BadSolver,
    "throttle": Throttle,
    "hogs": Hogs,
    "disk_full": StoppedRecording,
    "rival": SecondController,
    "two_poses": SecondPoses,
    "bad_start": BadStart,
    "bad_live": BadLiveParameters,
    "push": Push,
    "tilt": Tilt,
}


def action_of(fault: Fault) -> Action:
    """Return the action of a fault."""
    action: Action = _ACTIONS[fault.action](**fault.options)
    return action


def _set_pace(session: FaultSession, factor: float) -> None:
    (result,) = session.set_parameters("simulator", real_time_factor=factor)
    if not result.successful:
        raise SessionError(f"real_time_factor {factor:g} was refused: {result.reason}")
