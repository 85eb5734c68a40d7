# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One trial: on the way to a goal something goes wrong for a while, and then all is judged."""

import math
import time
from pathlib import Path

from std_srvs.srv import Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.faults.catalogue import Fault, name_of
from sphere_sim.faults.outcome import Outcome
from sphere_sim.recording.run_reader import read_run
from sphere_sim.ros.faults.actions import action_of
from sphere_sim.ros.faults.on_goals import random_goal
from sphere_sim.ros.faults.session import FaultSession

UNDER_WAY = 1.5
"""Simulated time on the way to the goal before the fault [s]."""
_STAYED = 1.0
"""How long the goal has to be held to count as reached [s], simulated."""
_DEADLINE = 90.0
"""Simulated time from the end of the fault to the goal after which it is given up [s]."""
_WALL_DEADLINE = 120.0
"""The same on the wall [s], should time stand still."""
_REST = 0.2
"""For how long the rotors have to rest before a blind controller sees again [s].

They should rest a good second after the last pose: it grows old, the next sample instant sees
that, the ramp follows. On a busy machine it takes longer until they hear of it.
"""


class Trial:
    """Try one fault, or several at once.

    Parameters
    ----------
    session : FaultSession
        Whose nodes are on trial.
    faults : tuple of Fault
        What goes wrong.
    """

    def __init__(self, session: FaultSession, faults: tuple[Fault, ...]) -> None:
        self._session = session
        self._monitor = session.monitor
        self._faults = faults
        self._complaints: list[str] = []

    def run(self) -> Outcome:
        """Run the trial; a fault that the campaign itself cannot handle is a complaint."""
        session, monitor = self._session, self._monitor
        goal = random_goal(session.rng)
        monitor.begin(goal)
        tracebacks = self._tracebacks()
        recovery = math.nan
        recorded = set(self._bags())
        try:
            session.ask("recorder/start", Trigger.Request())
            session.send_goal(goal)
            self._pass(UNDER_WAY)
            monitor.limits.continuous = all(fault.continuous for fault in self._faults)
            self._suffer()
            ended = monitor.time
            if any(fault.goal_again for fault in self._faults):
                session.send_goal(goal)
            recovery = self._arrive(ended)
        except (SphereNmpcError, OSError) as error:
            self._complaints.append(str(error))
        self._judge(tracebacks)
        self._judge_bags(recorded)
        monitor.limits.continuous = True
        return Outcome(
            name_of(self._faults), recovery, monitor.limits.worst_speed,
            monitor.limits.worst_slew, tuple(self._complaints),
        )

    def _suffer(self) -> None:
        """Let the faults begin together, last and end together."""
        session, monitor = self._session, self._monitor
        actions = [action_of(fault) for fault in self._faults]
        begun = []
        try:
            for action in actions:
                begun.append(action)
                action.begin(session)
            began = monitor.time
            wall = time.monotonic()
            duration = max(fault.duration for fault in self._faults)
            while not self._is_over(began, wall, duration):
                for action in actions:
                    action.keep_on(session)
                session.spin(0.005)
            self._judge_blindness(began)
        finally:
            for action in reversed(begun):
                action.end(session)

    def _is_over(self, began: float, wall: float, duration: float) -> bool:
        """Tell whether a fault has lasted long enough, on the wall where time stands still."""
        if self._monitor.time >= began + duration:
            return True
        slow = min((f.options.get("factor", 1.0) for f in self._faults), default=1.0)
        patience = max(1.0, duration / self._session.settings.pace) + 1.0
        return time.monotonic() > wall + patience / min(1.0, slow)

    def _judge_blindness(self, began: float) -> None:
        """Complain of rotors that turned although the controller had been blind for long."""
        if not all(fault.blind for fault in self._faults):
            return
        turned = self._monitor.moving_until - began
        allowed = max(fault.duration for fault in self._faults) - _REST
        if turned > allowed:
            self._complaints.append(
                f"rotors turned {turned:.2f} s into blindness, expected at most {allowed:.2f} s"
            )

    def _arrive(self, ended: float) -> float:
        """Wait for the goal to be reached for good, and return after which time it was [s]."""
        monitor, wall = self._monitor, time.monotonic()
        while True:
            self._session.spin()
            since = monitor.inside_since
            if since is not None and monitor.time >= max(since, ended) + _STAYED:
                return max(0.0, since - ended)
            late = monitor.time > ended + _DEADLINE
            if late or time.monotonic() > wall + _WALL_DEADLINE:
                self._complaints.append(
                    f"not at the goal {monitor.time - ended:.1f} s after the fault: "
                    f"error {monitor.error:.3g}"
                )
                return math.nan

    def _pass(self, duration: float) -> None:
        until = self._monitor.time + duration
        self._session.wait(lambda: self._monitor.time >= until, 30.0, "simulated time to pass")

    def _judge(self, tracebacks: int) -> None:
        self._complaints.extend(self._monitor.limits.broken[:3])
        harmful = [fault for fault in self._faults if fault.named_by]
        # One of two may hide the other: who is dead or sees nothing cannot tell of bad poses.
        if harmful and not any(self._monitor.heard(fault.named_by) for fault in harmful):
            words = "' or '".join(word for fault in harmful for word in fault.named_by)
            self._complaints.append(f"nothing named {name_of(harmful)}: no '{words}'")
        for process in self._session.processes.values():
            if process.code is not None:
                self._complaints.append(process.wait(1.0))
        if self._tracebacks() > tracebacks:
            self._complaints.append("an error that nobody caught, see the logs")

    def _judge_bags(self, earlier: set[Path]) -> None:
        """Complain of a bag of this trial that cannot be read, or of there being none."""
        try:
            self._session.ask("recorder/stop", Trigger.Request())
            bags = [bag for bag in self._bags() if bag not in earlier]
            if not bags:
                self._complaints.append("nothing was recorded")
            for bag in bags:
                read_run(bag)
        except SphereNmpcError as error:
            self._complaints.append(str(error))

    def _bags(self) -> list[Path]:
        return sorted(self._session.settings.folder.glob("bag_*"))

    def _tracebacks(self) -> int:
        return sum(process.tracebacks() for process in self._session.processes.values())
