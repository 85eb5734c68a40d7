# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One trial: a fault during a run to a goal, and the evaluation of the recovery."""

import math
import time
from pathlib import Path

from std_srvs.srv import Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.faults.catalogue import Fault, name_of
from sphere_sim.faults.outcome import Outcome
from sphere_sim.ros.faults.actions import action_of
from sphere_sim.ros.faults.fault_session import FaultSession
from sphere_sim.ros.faults.goal_actions import random_goal, upright_goal
from sphere_sim.ros.session.goal_run import GoalRun, wait_until_settled

UNDER_WAY = 1.5
"""Simulated time from the confirmation of the goal to the beginning of the fault [s]."""
_DEADLINE = 90.0
"""Simulated time from the end of the fault after which the goal is given up [s]."""
_STALL_TIMEOUT = 60.0
"""Wall time without progress of simulated time after which the goal is given up [s]."""
_REST = 0.2
"""Time before the end of a fault from which the rotors of a blind controller have to rest [s].

They should rest a good second after the last pose: the pose becomes too old, the next sampling
instant detects that, the ramp follows. On a busy machine this takes longer.
"""


class Trial:
    """A trial of one fault, or of several together.

    Parameters
    ----------
    session : FaultSession
        Session with the nodes under test.
    faults : tuple of Fault
        The faults.
    repetition : int, optional
        Number among the trials of the same faults; with the seed it determines goal and faults.
    """

    def __init__(
        self, session: FaultSession, faults: tuple[Fault, ...], repetition: int = 0
    ) -> None:
        self._session = session
        self._repetition = repetition
        self._monitor = session.monitor
        self._faults = faults
        self._actions = [action_of(fault) for fault in faults]
        self._complaints: list[str] = []
        self.bags: tuple[Path, ...] = ()
        """What was recorded."""

    def run(self) -> Outcome:
        """Run the trial; an error of the campaign itself is a complaint too."""
        session, monitor = self._session, self._monitor
        session.draw(name_of(self._faults), self._repetition)
        upright = any(fault.upright for fault in self._faults)
        goal = upright_goal(session.rng) if upright else random_goal(session.rng)
        run = monitor.begin(goal)
        tracebacks = self._tracebacks()
        recovery = math.nan
        recorded = set(self._bags())
        try:
            session.call("recorder/start", Trigger.Request())
            session.send_goal(goal)
            self._pass(UNDER_WAY)
            monitor.limits.continuous = all(fault.continuous for fault in self._faults)
            self._apply_faults()
            ended = monitor.time
            if any(fault.goal_again for fault in self._faults):
                session.send_goal(goal)
            recovery = self._recover(run, ended)
            for action in self._actions:
                action.clear(session)
        except (SphereNmpcError, OSError) as error:
            self._complaints.append(str(error))
        self._judge(tracebacks)
        self._end_recording(recorded)
        monitor.limits.continuous = True
        return Outcome(
            name_of(self._faults), recovery, monitor.limits.worst_speed,
            monitor.limits.worst_slew, tuple(self._complaints), self._repetition,
        )

    def _apply_faults(self) -> None:
        """Begin all faults, let them last, and end them."""
        session, monitor = self._session, self._monitor
        begun = []
        try:
            for action in self._actions:
                begun.append(action)
                action.begin(session)
            began = monitor.time
            wall = time.monotonic()
            duration = max(fault.duration for fault in self._faults)
            while not self._is_over(began, wall, duration):
                for action in self._actions:
                    action.keep_on(session)
                session.spin(0.005)
            self._judge_blindness(began)
        finally:
            for action in reversed(begun):
                action.end(session)

    def _is_over(self, began: float, wall: float, duration: float) -> bool:
        """Return whether the faults have lasted long enough; by wall time if time stands still."""
        if self._monitor.time >= began + duration:
            return True
        slow = min((f.options.get("factor", 1.0) for f in self._faults), default=1.0)
        patience = max(1.0, duration / self._session.settings.pace) + 1.0
        return time.monotonic() > wall + patience / min(1.0, slow)

    def _judge_blindness(self, began: float) -> None:
        """Complain if rotors turned long after the controller had received its last pose."""
        if not all(fault.blind for fault in self._faults):
            return
        turned = self._monitor.moving_until - began
        allowed = max(fault.duration for fault in self._faults) - _REST
        if turned > allowed:
            self._complaints.append(
                f"rotors turned for {turned:.2f} s without poses, expected at most {allowed:.2f} s"
            )

    def _recover(self, run: GoalRun, ended: float) -> float:
        """Return the time from the end of the faults to reaching the goal [s]; nan if it fails."""
        deadline = ended + _DEADLINE
        spin = self._session.spin
        settled = wait_until_settled(run, spin, deadline, _STALL_TIMEOUT, not_before=ended)
        if settled is not None:
            return max(0.0, settled - ended)
        self._complaints.append(
            f"not at the goal {run.time - ended:.1f} s after the fault: error {run.error:.3g}"
        )
        return math.nan

    def _pass(self, duration: float) -> None:
        until = self._monitor.time + duration
        self._session.wait(lambda: self._monitor.time >= until, 30.0, "simulated time to pass")

    def _judge(self, tracebacks: int) -> None:
        self._complaints.extend(self._monitor.limits.broken[:3])
        harmful = [fault for fault in self._faults if fault.named_by]
        # One of two may hide the other: a controller that was killed cannot report bad poses.
        if harmful and not any(self._monitor.reported(fault.named_by) for fault in harmful):
            words = "' or '".join(word for fault in harmful for word in fault.named_by)
            self._complaints.append(f"no message named {name_of(harmful)}: no '{words}'")
        for process in self._session.processes:
            if process.code is not None:
                self._complaints.append(process.ending)
        if self._tracebacks() > tracebacks:
            self._complaints.append("an uncaught exception, see the logs")

    def _end_recording(self, earlier: set[Path]) -> None:
        """Note the bags of this trial; complain if there is none."""
        try:
            self._session.call("recorder/stop", Trigger.Request())
        except SphereNmpcError as error:
            self._complaints.append(str(error))
        self.bags = tuple(bag for bag in self._bags() if bag not in earlier)
        if not self.bags:
            self._complaints.append("nothing was recorded")

    def _bags(self) -> list[Path]:
        return sorted(self._session.settings.folder.glob("bag_*"))

    def _tracebacks(self) -> int:
        return sum(process.tracebacks for process in self._session.processes)
