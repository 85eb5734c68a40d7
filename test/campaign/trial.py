# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Trials: a fault during a run to a goal, and the evaluation of the recovery."""

import atexit
import contextlib
import math
import multiprocessing
import os
import signal
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from catalogue import FAULTS, Fault, name_of
from judge import Judge, Reports
from node_session import Session, SessionError, random_goal
from outcome import Outcome
from std_srvs.srv import Trigger

from sphere_nmpc.child import TERMINAL_SIGNALS, module_command
from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.metrics import GoalRun
from sphere_sim.recording.run_reader import read_run
from sphere_sim.ros.session.child_process import verb_command
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.goal_run import wait_until_settled

RATE = 20.0
"""Rate of poses, clock and commands [Hz], low enough for the relay on a busy machine."""
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
_PRIORITY = 1
"""Real-time priority of controller, simulator and relay, where the system allows it."""
_SERVO_ERROR = {"rolling": 0.0, "rigid_body": 0.07}
"""By plant, see `LimitCheck` [rad/s]. A servo of bandwidth b follows a rotor whose axis
accelerates by a with the error a / b. Rotors that ramp at 400 rad/s^2 accelerate the shell by
10 rad/s^2 about their axes, in either direction: 2 * 10 / 300."""


@dataclass(frozen=True)
class Settings:
    """What all trials of a campaign have in common."""

    seed: int = 0
    """Seed of the goals and of random faults."""
    rtf: float = 2.0
    """Simulated over wall time."""
    strategy: str = "time_optimal"
    plant: str = "rolling"
    rate: float = RATE
    """Rate of poses, clock and commands, and if it is not the default one, of solves [Hz]."""


@dataclass(frozen=True)
class Plan:
    """A trial that is to be run, of faults that are caused at the same time."""

    faults: tuple[str, ...]
    repetition: int = 0
    """Number among the trials of the same faults."""

    @property
    def name(self) -> str:
        """Name of the faults together."""
        return name_of(FAULTS[name] for name in self.faults)


class CampaignSession(Session):
    """Simulator, controller with a solver that can fail, and recorder."""

    def __init__(self, folder: Path, settings: Settings) -> None:
        self.settings = settings
        self.solver_file = folder.absolute() / "solver"
        controller = module_command("bad_strategy", str(os.getpid()), str(self.solver_file))
        given: dict[str, dict[str, object]] = {
            "simulator": {
                "plant": settings.plant, "real_time_factor": settings.rtf,
                "pose_rate": settings.rate, "thread_priority": _PRIORITY,
            },
            "controller": {
                "use_sim_time": True, "strategy": settings.strategy, "thread_priority": _PRIORITY,
                "command_rate": settings.rate,
                "control_rate": 0.0 if settings.rate == RATE else settings.rate,
            },
            "recorder": {"use_sim_time": True},
        }
        commands = {name: verb_command(name) for name in given} | {"controller": controller}
        judge = Judge(_SERVO_ERROR[settings.plant])
        super().__init__(folder, commands, given, judge)
        self.reports = Reports(self.node)
        self.cleanups: list[Callable[[], None]] = []
        """What the faults leave to be done after the recovery."""

    def __enter__(self) -> "CampaignSession":
        """Start all nodes and wait until they work."""
        self.start(*self.nodes)
        self.wait(lambda: self.judge.time > 0.0, "simulated time")
        self.wait_for(*self.nodes)
        # Each trial records a bag of its own.
        self.call("recorder/stop", Trigger.Request())
        _schedule_in_real_time()
        return self

    def draw(self, name: str, repetition: int) -> None:
        """Begin the random numbers of a trial, so that they do not depend on others."""
        identity = zlib.crc32(name.encode())
        self.rng = np.random.default_rng([self.settings.seed, identity, repetition])
        self.relay.poses.rng = self.rng

    def send_goal(self, goal: Vector) -> None:
        """Bring a goal, shape (6,), into force."""
        self.wait(self.try_goal(goal), "the confirmation of a goal")


def _schedule_in_real_time() -> None:
    """Give the threads of this process the priority of the nodes, between which it is.

    Where the system does not allow it, nothing changes, as for the nodes.
    """
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # not for what is started later
    with contextlib.suppress(PermissionError):
        for task in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(task.name), policy, os.sched_param(_PRIORITY))


class Trial:
    """A trial of one fault, or of several together."""

    def __init__(self, session: CampaignSession, plan: Plan) -> None:
        self._session = session
        self._judge = session.judge
        self._plan = plan
        self._faults: list[Fault] = [FAULTS[name] for name in plan.faults]
        self._complaints: list[str] = []

    def run(self) -> tuple[Outcome, tuple[Path, ...]]:
        """Return the outcome and what was recorded; an error of the campaign is a complaint."""
        session, plan, limits = self._session, self._plan, self._judge.limits
        session.draw(plan.name, plan.repetition)
        goal = random_goal(session.rng, upright=any(fault.upright for fault in self._faults))
        run = self._judge.begin(goal)
        session.reports.messages.clear()
        tracebacks, recorded, recovery = self._tracebacks(), set(self._bags()), math.nan
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
            while session.cleanups:
                session.cleanups.pop()()
        except (SphereNmpcError, OSError) as error:
            self._complaints.append(str(error))
        self._judge_reports(tracebacks)
        bags = self._end_recording(recorded)
        limits.continuous = True
        outcome = Outcome(
            plan.name, recovery, limits.worst_speed, limits.worst_slew,
            tuple(self._complaints), plan.repetition,
        )
        return outcome, bags

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

    def _judge_reports(self, tracebacks: int) -> None:
        session = self._session
        self._complaints.extend(self._judge.limits.broken[:3])
        harmful = [fault for fault in self._faults if fault.named_by]
        # One of two may hide the other: a controller that was killed cannot report bad poses.
        if harmful and not any(session.reports.name(fault.named_by) for fault in harmful):
            words = "' or '".join(word for fault in harmful for word in fault.named_by)
            self._complaints.append(f"no message named {name_of(harmful)}: no '{words}'")
        self._complaints += [p.ending for p in session.processes if p.code is not None]
        if self._tracebacks() > tracebacks:
            self._complaints.append("an uncaught exception, see the logs")

    def _end_recording(self, earlier: set[Path]) -> tuple[Path, ...]:
        """Return the bags of this trial; complain if there is none."""
        try:
            self._session.call("recorder/stop", Trigger.Request())
        except SessionError as error:
            self._complaints.append(str(error))
        bags = tuple(bag for bag in self._bags() if bag not in earlier)
        if not bags:
            self._complaints.append("nothing was recorded")
        return bags

    def _bags(self) -> list[Path]:
        return sorted(self._session.folder.glob("bag_*"))

    def _tracebacks(self) -> int:
        return sum(process.tracebacks for process in self._session.processes)


def run_trials(
    plans: Sequence[Plan], settings: Settings, folder: Path, jobs: int
) -> Iterator[Outcome]:
    """Yield the outcome of each trial as it is done.

    Each of the `jobs` processes has nodes, a ROS domain, and folders in `folder` of its own.
    """
    if not plans:
        return
    context = multiprocessing.get_context("spawn")
    # Where it ends early, its processes are terminated, which end their nodes.
    with context.Pool(min(jobs, len(plans)), _Sessions.prepare, (settings, folder)) as pool:
        for outcome, bags in pool.imap_unordered(_Sessions.run, plans):
            yield _with_bags(outcome, bags)  # while the next trial runs
        pool.close()
        pool.join()


class _Sessions:
    """The sessions of a process of `run_trials`, one after the other."""

    domain, current = contextlib.ExitStack(), contextlib.ExitStack()
    session: CampaignSession | None = None
    number = 0
    settings: Settings
    folder: Path

    @classmethod
    def prepare(cls, settings: Settings, folder: Path) -> None:
        """Prepare the process; its first session begins with its first trial."""
        for number in TERMINAL_SIGNALS:
            signal.signal(number, signal.SIG_IGN)  # the parent decides
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
        cls.settings, cls.folder = settings, folder
        atexit.register(cls.domain.close)
        atexit.register(cls.current.close)

    @classmethod
    def run(cls, plan: Plan) -> tuple[Outcome, tuple[Path, ...]]:
        """Run a trial; after one that was not survived nodes are restarted."""
        try:
            if not cls.number:
                cls.domain.enter_context(own_domain())
            if cls.session is None:
                cls.number += 1
                folder = cls.folder / f"session_{os.getpid()}_{cls.number}"
                cls.session = cls.current.enter_context(CampaignSession(folder, cls.settings))
            outcome, bags = Trial(cls.session, plan).run()
            if not outcome.survived:
                cls.session = None
                cls.current.close()
            return outcome, bags
        except SphereNmpcError as error:
            raise SphereNmpcError(str(error)) from None  # others may not be sent to the parent


def _with_bags(outcome: Outcome, bags: tuple[Path, ...]) -> Outcome:
    """Return the outcome of a trial with a complaint about each bag that cannot be read.

    It is not done between two trials, as the relay has to serve the nodes all the time.
    """
    complaints = list(outcome.complaints)
    for bag in bags:
        try:
            read_run(bag)
        except SphereNmpcError as error:
            complaints.append(str(error))
    return replace(outcome, complaints=tuple(complaints))
