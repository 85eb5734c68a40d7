# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzing of all nodes as running processes: what ends a node, breaks a limit or stops control.

Tries one fault after another, or two at once: malformed and extreme messages, parameters,
services, clocks, goals and signals, see `tries`. Afterwards all is restored, a new goal is sent,
and the time is measured until the rotors follow a command to it.
"""

import argparse
import json
import math
import random
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from hostile import FORGED, example
from judge import Judge
from node_session import Session, SessionError, class_of, random_goal
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from relay import stamped, taken
from std_srvs.srv import SetBool, Trigger
from tries import TRIES

from sphere_nmpc.foreign_text import shown
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state, state_error
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.output.files import write_atomically
from sphere_sim.ros.session.child_process import verb_command

MOST_AHEAD = 0.5
"""Largest time from the true clock to the start of a command [s]."""
LONGEST = 10.0
"""Longest duration of a command [s]: for so long the rotors turn after a controller was killed."""
_GRACE = 1.0
"""Wall time that a controller has to notice that the true clock went back [s]."""
_FOLLOWED = 5.0
"""Largest difference of commanded and measured speeds that counts as following [rad/s]."""
_MOVING = 1.0
"""Speed above which a command counts as motion [rad/s]."""
_RATE = 50.0
"""Rate of poses and commands [Hz]."""
_PARAMETERS: dict[str, dict[str, object]] = {
    "simulator": {"pose_rate": _RATE},
    "controller": {"use_sim_time": True, "command_rate": _RATE},
    "recorder": {"use_sim_time": True},
    "viewer": {},
    "markers": {"use_sim_time": True},
}
"""Verbs of the nodes, and their parameters."""
_PATIENCE = 120.0
"""Wall time after which control counts as lost [s], and likewise that the goal gets nearer."""
_NOTICED = 1.0
"""Wall time until a controller and the judge have noticed what was restored [s]."""
_LATER = NANOSECONDS // 20
"""Time from the newest known one to a pose after a reset; earlier ones may still come [ns]."""
_NEAR = 0.1
"""Error below which the sphere is near its goal [mixed units]."""
_FAR = 5.0
"""Distance from the origin beyond which the sphere is put back to its start [m]."""
_LONGEST_LINE = 500
"""Characters of a line of a log."""
_REPORT_EVERY = 20.0
"""Wall time between two lines of progress [s]."""


class FuzzJudge(Judge):
    """Judge that also demands of each command that it begins soon, is short and ends at rest.

    `fail` takes what is wrong, in words that do not change, and the detail.
    """

    def __init__(self, fail: Callable[..., None]) -> None:
        super().__init__()
        self._fail = fail
        self.lenient_until = 0.0
        """Wall time until which the rotors may be set to rest at once, as by a reset, and the
        controller may follow the system clock [s]."""
        self.worst = {"speed_rad_s": 0.0, "slew_rad_s2": 0.0, "ahead_s": 0.0, "duration_s": 0.0}
        self._hold: tuple[float, int, FirstOrderHold] | None = None
        self._true_times: deque[tuple[int, int]] = deque(maxlen=500)
        self._back_until = 0

    def clock(self, raw: bytes, wall: int, shift: int) -> None:
        super().clock(raw, wall, shift)
        shifted = self.now + shift
        if self._true_times and shifted < self._true_times[-1][1]:
            self._back_until = wall + round(_GRACE * NANOSECONDS)
        self._true_times.append((wall, shifted))

    def joints(self, raw: bytes, wall: int, shift: int) -> None:
        if time.monotonic() < self.lenient_until:
            self.limits.restart()
        super().joints(raw, wall, shift)

    def take_hold(self, hold: FirstOrderHold, stamp: int, wall: int, shift: int) -> None:
        """Judge a hold, relative to its stamp."""
        self._hold = (time.monotonic(), stamp - shift, hold)
        if np.any(hold.speeds[-1] != 0.0):
            self._fail("commands that do not end at rest", f"{hold.speeds[-1].tolist()} rad/s")
        self.worst["duration_s"] = max(self.worst["duration_s"], hold.end)
        if hold.end > LONGEST:
            self._fail("commands that are too long", f"{hold.end:.3f} s")
        true = next((then for at, then in reversed(self._true_times) if at <= wall), None)
        if true is None or wall < self._back_until:
            return
        ahead = (stamp - true) / NANOSECONDS
        if time.monotonic() < self.lenient_until:
            ahead = min(ahead, (stamp - wall) / NANOSECONDS)
        self.worst["ahead_s"] = max(self.worst["ahead_s"], ahead)
        if ahead > MOST_AHEAD:
            self._fail("commands more than 0.5 s ahead", f"{ahead:.3f} s ahead of the true clock")

    def delivered(self, raw: bytes) -> None:
        """Take a command on its way to the drives, on which others may have others' commands."""

    def follows(self, since: float) -> bool:
        """Return whether the rotors follow a command of the controller.

        It is in motion and was received after `since` [s; steady clock].
        """
        if self._hold is None or self._hold[0] < since:
            return False
        _, start, hold = self._hold
        wanted = hold.at((self.joint_stamp - start) / NANOSECONDS)
        difference = float(np.max(np.abs(wanted - self.speeds)))
        return bool(np.max(np.abs(wanted)) > _MOVING) and difference < _FOLLOWED

    def collect(self) -> None:
        """Complain about violations of the limits."""
        limits = self.limits
        self.worst["speed_rad_s"] = max(self.worst["speed_rad_s"], limits.worst_speed)
        self.worst["slew_rad_s2"] = max(self.worst["slew_rad_s2"], limits.worst_slew)
        for text in limits.broken:
            self._fail("commands out of limits", text)
        limits.begin()


class FuzzSession(Session):
    """All nodes, what a try can use, their restoration, and the test of control.

    `fail` takes a complaint: in words that do not change, in detail, and whom it is about.
    """

    judge: FuzzJudge

    def __init__(self, folder: Path, fail: Callable[..., None]) -> None:
        commands = {name: verb_command(name) for name in _PARAMETERS}
        commands["viewer"] += ["--port", "0"]
        super().__init__(folder, commands, _PARAMETERS, FuzzJudge(fail))
        self.fail = fail
        self.alone = True
        """Whether the present try is the only one."""
        self.is_pushed = False
        """Whether the present try may have pushed the sphere."""
        self.expected: set[str] = set()
        """Nodes whose end is wanted."""
        self.topics: dict[str, type] = {}
        """Topics to which a node subscribes, with their types."""
        self.parameters: dict[str, dict[str, ParameterValue]] = {}
        """Parameters of each node, as they were at the beginning."""
        self._examples: dict[str, bytes] = {}
        self._read: Counter[str] = Counter()

    def start(self, *names: str) -> None:
        """Start nodes and wait until they answer."""
        super().start(*names)
        self.expected.difference_update(names)
        self.wait_for(*names)

    def learn(self) -> None:
        """Find parameters, services and topics of the nodes, and an example of each message."""
        for name in self.nodes:
            names = self.call(f"{name}/list_parameters", ListParameters.Request()).result.names
            self.parameters[name] = dict(zip(names, self._values(name, names), strict=True))
            self.parameters[name].pop("output", None)  # a folder of its own at each start
            for topic, types in self.node.get_subscriber_names_and_types_by_node(name, "/"):
                self.topics[topic] = class_of(types[0])
            for service, types in self.node.get_service_names_and_types_by_node(name, "/"):
                if types[0].startswith("std_srvs"):
                    self.services[service.strip("/")] = class_of(types[0])
        subscriptions = {
            topic: self._reader.create_subscription(kind, topic, lambda _: None, 10, raw=True)
            for topic, kind in self.topics.items()
        }
        self.until(lambda: False, 3.0)
        for topic, subscription in subscriptions.items():
            found = taken(subscription)
            self._examples[topic] = found[-1][0] if found else example(self.topics[topic])
            self._reader.destroy_subscription(subscription)

    def current_example(self, topic: str) -> bytes:
        """Return a valid message for a topic; stamped with now, if it begins with a stamp."""
        data = self._examples[topic]
        if topic not in ("/clock", "/pose", "/joint_states", "/rotor_trajectory"):
            return data
        return stamped(data, self.judge.now + self.relay.shift)

    def spin(self) -> None:
        """Serve as a `Session` does, and look for nodes that have ended."""
        super().spin()
        self.judge.collect()
        for process in self.processes:
            if process.code is not None and process.name not in self.expected:
                self.expected.add(process.name)
                lines = [line for line in process.output.splitlines() if line.strip()]
                self.fail("nodes ended", f"{process.ending}: {(lines or [''])[-1]}",
                          process.name)

    def serve_own(self) -> None:
        """Serve this process's own node, which may be asked anything, too."""
        with suppress(Exception):
            super().serve_own()

    def restore(self) -> None:
        """Start nodes that have ended, and undo what the tries have changed."""
        judge = self.judge
        try:
            self.start(*(name for name in self.nodes if self.processes[name].code is not None))
            for name in self.nodes:
                self._restore_parameters(name)
            self.call("simulator/pause", SetBool.Request(data=False))
            self.call("controller/enable", SetBool.Request(data=True))
            self.call("recorder/start", Trigger.Request())
            if self.is_pushed or not self._is_near():
                judge.lenient_until = math.inf
                self.call("simulator/reset", Trigger.Request())
                done = judge.now + _LATER
                self.wait(
                    lambda: judge.pose_stamp > done and self._is_near(), "a pose of the start"
                )
        finally:
            self.is_pushed = False
            judge.lenient_until = min(judge.lenient_until, time.monotonic() + _NOTICED)

    def control_back(self, rng: np.random.Generator) -> float | None:
        """Send a goal; return the time until the rotors follow a command to it [s, wall].

        None if they do not, or if the sphere does not get nearer to the goal afterwards.
        """
        began, judge, goal = time.monotonic(), self.judge, self._near_goal(rng)
        confirmed = self.try_goal(goal)

        def error() -> float:
            return math.inf if judge.state is None else state_error(judge.state, goal)

        def given_up() -> bool:
            return any(self.processes[name].code is not None for name in self.nodes)

        came = self.until(
            lambda: given_up() or (confirmed() and judge.follows(began)), _PATIENCE
        )
        if given_up():  # which is a complaint already
            return None
        if not came:
            known = "confirmed" if confirmed() else "not confirmed"
            self.fail("control did not come back", f"goal {known}, no rotor follows a command to "
                      f"it within {_PATIENCE:g} s, rotors at {judge.turning:.3g} rad/s")
            return None
        took, wanted = time.monotonic() - began, max(0.5 * error(), _NEAR)
        if not self.until(lambda: error() < wanted, _PATIENCE):
            self.fail("goals that get no nearer", f"error {error():.3g} after {_PATIENCE:g} s")
            return None
        return took

    def check_logs(self) -> None:
        """Complain about what the nodes have logged since the last time."""
        for process in self.processes:
            with process.log.open("rb") as log:
                log.seek(self._read[process.name])
                whole, _, _ = log.read().rpartition(b"\n")
            self._read[process.name] += len(whole) + (1 if whole else 0)
            for line in whole.decode(errors="replace").split("\n"):
                for what in faults_of_line(line):
                    self.fail(what, f"{process.name}: {line}", process.name)

    def _is_near(self) -> bool:
        """Return whether the sphere is not too far from the origin."""
        state = self.judge.state
        return state is not None and bool(np.max(np.abs(state[POSITION])) < _FAR)

    def _near_goal(self, rng: np.random.Generator) -> Vector:
        """Return a goal between the origin and the sphere, shape (6,)."""
        place = np.zeros(2) if self.judge.state is None else 0.5 * self.judge.state[POSITION]
        drawn = random_goal(rng, 1.0)
        return make_state(place + drawn[POSITION], drawn[QUATERNION])

    def _values(self, node: str, names: Sequence[str]) -> list[ParameterValue]:
        request = GetParameters.Request(names=list(names))
        return list(self.call(f"{node}/get_parameters", request).values)

    def _restore_parameters(self, node: str) -> None:
        wanted = self.parameters[node]
        for name, value in zip(wanted, self._values(node, list(wanted)), strict=True):
            if value != wanted[name]:
                parameter = ParameterMessage(name=name, value=wanted[name])
                request = SetParameters.Request(parameters=[parameter])
                (result,) = self.call(f"{node}/set_parameters", request).results
                if not result.successful:
                    self.fail("parameters not restored", f"{node} {name}: {result.reason}")


class Fuzz:
    """Tries one after another, of the given kinds, and their complaints."""

    def __init__(self, seed: int, kinds: Sequence[str], folder: Path) -> None:
        self._seed, self._kinds = seed, list(kinds)
        self.failures: list[dict[str, object]] = []
        self.counts: Counter[str] = Counter()
        self._tried: Counter[str] = Counter()
        self._told: set[tuple[int, str, str]] = set()
        self._back: list[tuple[float, int, str]] = []
        self._number, self._name = 0, "start"
        self.session = FuzzSession(folder, self._fail)

    def prepare(self) -> None:
        """Start the nodes, and learn what they have."""
        self.session.start(*self.session.nodes)
        self.session.control_back(np.random.default_rng(self._seed))
        self.session.learn()

    def one(self, number: int) -> None:
        """Cause a fault, or two at once, for some seconds; then restore all, and judge."""
        session, rng = self.session, random.Random(f"{self._seed}:{number}")
        kinds = rng.sample(self._kinds, 2 if rng.random() < 0.3 and len(self._kinds) > 1 else 1)
        self._number, self._name = number, "+".join(kinds)
        session.alone = len(kinds) == 1
        self._tried.update(kinds)
        drawn = {kind: random.Random(f"{self._seed}:{number}:{kind}") for kind in kinds}
        tries = [TRIES[kind](session, rng) for kind, rng in drawn.items()]
        duration = rng.uniform(1.0, 5.0)
        running = [one for one in tries if next(one, one) is not one]
        end = time.monotonic() + duration  # what they wait for first does not count
        while running and time.monotonic() < end:
            session.spin()
            running = [one for one in running if next(one, one) is not one]
        for one in tries:
            one.close()
        try:
            session.restore()
            seconds = session.control_back(np.random.default_rng([self._seed, number]))
        except SessionError as error:
            self._fail("requests without an answer", str(error))
            seconds = None
        if seconds is None:  # the next try needs nodes that work
            session.expected.update(session.nodes)
            session.start(*session.nodes)
        else:
            self._back.append((seconds, number, self._name))
        session.check_logs()

    def _fail(self, what: str, detail: str, about: str = "") -> None:
        """Count a complaint, and tell the first of its kind in each try."""
        self.counts[what] += 1
        if (self._number, what, about) in self._told:
            return
        self._told.add((self._number, what, about))
        one = {"try": self._number, "kinds": self._name, "what": what, "detail": shown(detail)}
        self.failures.append(one)
        print(f"try {self._number} ({self._name}): {what}: {shown(detail)}", flush=True)

    def __str__(self) -> str:
        found = ", ".join(f"{count} {what}" for what, count in sorted(self.counts.items()))
        times = ", ".join(f"{key} {value}" for key, value in _distribution(self._back).items())
        return f"{sum(self._tried.values())} faults: {found or 'no complaint'}; {times}"

    def write(self, path: Path | None) -> None:
        """Write the result so far to a file, if there is one."""
        if path is None:
            return
        judge = self.session.judge
        worst = {k: round(v, 4) if math.isfinite(v) else None for k, v in judge.worst.items()}
        result = {
            "seed": self._seed, "tries": self._number, "commands_judged": judge.count,
            "worst": worst, "counts": dict(self.counts),
            "seconds_without_control": _distribution(self._back),
            "kinds": dict(self._tried), "failures": self.failures,
        }
        write_atomically(path, json.dumps(result, indent=2) + "\n")


def fuzz(given: argparse.Namespace, folder: Path) -> bool:
    """Fuzz for a time, or repeat some tries; return whether there is no complaint."""
    campaign = Fuzz(given.seed, given.kinds, folder)
    try:
        with campaign.session:
            campaign.prepare()
            end, reported = time.monotonic() + 60.0 * given.minutes, time.monotonic()
            for number in given.only or range(1, sys.maxsize):
                if time.monotonic() > end:
                    break
                campaign.one(number)
                if time.monotonic() > reported + _REPORT_EVERY:
                    reported = time.monotonic()
                    print(f"{(end - reported) / 60.0:.1f} min left, {campaign}", flush=True)
                    campaign.write(given.json)
    finally:
        campaign.write(given.json)
        print(f"seed {given.seed}, {campaign}")
    return not campaign.counts


def faults_of_line(line: str) -> Iterator[str]:
    """Yield what is wrong with a line of a log."""
    if line.startswith("Traceback (most recent call last)"):
        yield "tracebacks"
    if "RuntimeWarning:" in line and "rclpy" not in line:  # rclpy's are about lost clients
        yield "warnings of libraries in a log"
    if len(line) > _LONGEST_LINE:
        yield "long lines in a log"
    if line.startswith(FORGED):
        yield "forged lines in a log"
    if any(not character.isprintable() and character != "\t" for character in line):
        yield "control characters in a log"


def _distribution(back: list[tuple[float, int, str]]) -> dict[str, object]:
    """Return the distribution of times until control is back [s], with the try of the worst."""
    if not back:
        return {"control_back": "never"}
    times = sorted(back)
    return {
        "median_s": round(times[len(times) // 2][0], 3),
        "p99_s": round(times[math.ceil(0.99 * len(times)) - 1][0], 3),
        "worst_s": round(times[-1][0], 3),
        "worst_try": f"{times[-1][1]} ({times[-1][2]})",
    }
