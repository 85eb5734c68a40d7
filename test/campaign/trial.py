# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Trials: a fault during a run to a goal, the evaluation of the recovery, and its outcome."""

import contextlib
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from actions import memory_of
from catalogue import Fault, name_of
from hostile import FORGED, random_goal
from node_session import Session, Settings
from std_srvs.srv import Trigger

from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.evaluation.metrics import GoalRun
from sphere_sim.recording.run_reader import read_run
from sphere_sim.ros.session.goal_run import wait_until_settled

_UNDER_WAY = 1.5
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
_CATCH_UP = 0.5
"""Wall time between two trials [s]."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one trial."""

    fault: str
    """Name of the fault, or of several."""
    recovery: float = math.nan
    """Time from the end of the fault to settling at the goal [s, simulated]; nan if it did not."""
    worst_speed: float = 0.0
    """Largest rotor speed, commanded or measured [rad/s]."""
    worst_slew: float = 0.0
    """Largest rotor acceleration, commanded or measured [rad/s^2]."""
    complaints: tuple[str, ...] = ()
    """Reasons why it does not count as survived."""
    repetition: int = 0
    """Number of the trial among those of the same fault, from 0 on."""
    memory: float = 0.0
    """Resident memory of the controller and its worker at the end [MB]."""

    @property
    def survived(self) -> bool:
        """Whether there is no complaint."""
        return not self.complaints

    def __str__(self) -> str:
        if not self.survived:
            return f"{self.fault}: {'; '.join(self.complaints)}"
        return f"{self.fault}: survived, at the goal {self.recovery:.2f} s after it"


class Trial:
    """A trial of one fault, or of several together."""

    def __init__(
        self, session: Session, faults: Sequence[Fault], repetition: int = 0
    ) -> None:
        self._session, self._judge = session, session.judge
        self._faults, self._repetition = faults, repetition
        self._name = name_of(faults)
        self._complaints: list[str] = []

    def run(self) -> Outcome:
        """Return the outcome; an error of the campaign is a complaint."""
        session, limits = self._session, self._judge.limits
        session.draw(self._name, self._repetition)
        goal = random_goal(session.rng, upright=any(fault.upright for fault in self._faults))
        run = self._judge.begin(goal)
        session.reports.messages.clear()
        recorded, recovery = set(self._bags()), math.nan
        logged = {process.name: len(process.output) for process in session.processes}
        try:
            session.call("recorder/start", Trigger.Request())
            session.send_goal(goal)
            begun = self._judge.time + _UNDER_WAY
            session.wait(lambda: self._judge.time >= begun, "simulated time to pass")
            limits.continuous = all(fault.continuous for fault in self._faults)
            self._apply_faults()
            ended = self._judge.time
            if any(fault.goal_again for fault in self._faults):
                session.send_goal(goal)
            recovery = self._recover(run, ended)
        except (SphereNmpcError, OSError) as error:
            self._complaints.append(str(error))
        self._judge_reports(logged)
        self._judge_recording(recorded)
        limits.continuous = True
        return Outcome(
            self._name, recovery, limits.worst_speed, limits.worst_slew,
            tuple(self._complaints), self._repetition,
            memory_of(session.processes["controller"].pid),
        )

    def _apply_faults(self) -> None:
        """Begin all faults, let them last, and end them."""
        session = self._session
        with contextlib.ExitStack() as ends:
            repeated = []
            for fault in self._faults:
                action = fault.action(session, **fault.options)
                repeated.append(next(action))
                ends.callback(next, action, None)
            began, wall = self._judge.time, time.monotonic()
            duration = max(fault.duration for fault in self._faults)
            while not self._is_over(began, wall, duration):
                for repeat in filter(None, repeated):
                    repeat()
                session.spin()
            self._judge_blindness(began)

    def _is_over(self, began: float, wall: float, duration: float) -> bool:
        """Return whether the faults have lasted long enough; by wall time if time stands still."""
        if self._judge.time >= began + duration:
            return True
        slow = min(fault.options.get("factor", 1.0) for fault in self._faults)
        patience = max(1.0, duration / self._session.settings.rtf) + 1.0
        return time.monotonic() > wall + patience / min(1.0, slow)

    def _judge_blindness(self, began: float) -> None:
        """Complain if rotors turned long after the controller had received its last pose."""
        if not all(fault.blind for fault in self._faults):
            return
        turned = self._judge.moving_until - began
        allowed = max(fault.duration for fault in self._faults) - _REST
        if turned > allowed:
            self._complaints.append(
                f"rotors turned for {turned:.2f} s without poses, expected at most {allowed:.2f} s"
            )

    def _recover(self, run: GoalRun, ended: float) -> float:
        """Return the time from the end of the faults to reaching the goal [s]; nan if it fails."""
        deadline, spin = ended + _DEADLINE, self._session.spin
        settled = wait_until_settled(run, spin, deadline, _STALL_TIMEOUT, not_before=ended)
        if settled is not None:
            return max(0.0, settled - ended)
        self._complaints.append(
            f"not at the goal {run.time - ended:.1f} s after the fault: error {run.error:.3g}"
        )
        return math.nan

    def _judge_reports(self, logged: Mapping[str, int]) -> None:
        session = self._session
        self._complaints.extend(self._judge.limits.broken[:3])
        harmful = [fault for fault in self._faults if fault.named_by]
        is_named = any(session.reports.name(fault.named_by) for fault in harmful)
        # One of two may hide the other: a controller that was killed cannot report bad poses, and
        # a hostile fault ends nodes or floods their reports.
        is_told = all(fault.group != "hostile" for fault in self._faults)
        if harmful and is_told and not is_named:
            words = "' or '".join(word for fault in harmful for word in fault.named_by)
            self._complaints.append(f"no message named {name_of(harmful)}: no '{words}'")
        if session.reports.name(("wall touched",)) and not self._judge.contacts.excused:
            self._complaints.append("the sphere touched an obstacle")
        self._complaints += [p.ending for p in session.processes if p.code is not None]
        for process in session.processes:
            for line in process.output[logged.get(process.name, 0):].split("\n"):
                self._complaints += [f"{what} of {process.name}" for what in faults_of_line(line)]

    def _judge_recording(self, earlier: set[Path]) -> None:
        """End the recording; complain if there is no bag of this trial, or it cannot be read."""
        bags = None
        try:
            self._session.call("recorder/stop", Trigger.Request())
            bags = [bag for bag in self._bags() if bag not in earlier]
            for bag in bags:
                read_run(bag)
        except SphereNmpcError as error:
            self._complaints.append(str(error))
        if not bags:
            self._complaints.append("nothing was recorded")

    def _bags(self) -> list[Path]:
        return sorted(self._session.folder.glob("bag_*"))


def faults_of_line(line: str) -> Iterator[str]:
    """Yield what is wrong with a line of a log."""
    if line.startswith("Traceback (most recent call last)"):
        yield "an uncaught exception in the log"
    if "RuntimeWarning:" in line and "rclpy" not in line:  # rclpy's are about lost clients
        yield "a warning of a library in the log"
    if len(line) > 500:
        yield "a long line in the log"
    if line.startswith(FORGED):
        yield "a forged line in the log"
    if any(not character.isprintable() and character != "\t" for character in line):
        yield "control characters in the log"


def run_trials(
    plans: Iterable[tuple[tuple[Fault, ...], int]], settings: Settings, folder: Path,
    everything: bool = False,
) -> Iterator[Outcome]:
    """Yield the outcome of each trial, of faults that are caused together and a repetition.

    After a trial that was not survived, or that leaves momentum, the nodes are started again.
    """
    number, remaining = 0, iter(plans)
    plan = next(remaining, None)
    while plan:
        number += 1
        with Session(folder / f"session_{number}", settings, everything) as session:
            is_good = True
            while plan and is_good:
                outcome = Trial(session, *plan).run()
                yield outcome
                is_good = outcome.survived and not any(fault.upright for fault in plan[0])
                plan = next(remaining, None)
                # Pass on what came while the bag was read.
                session.until(lambda: False, _CATCH_UP)
