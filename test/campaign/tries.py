# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tries of the fuzzing: each is a generator that causes a fault until it is closed.

Afterwards the session restores parameters and services, and the plant where a try has set
``session.is_pushed``.
"""

import math
import random
import signal
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any

import actions
import numpy as np
from catalogue import FAULTS
from geometry_msgs.msg import PoseStamped
from hostile import TEXTS, damaged, extreme, parameter_value
from node_session import OF_PARAMETERS, RADIUS
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rclpy.qos import DurabilityPolicy, QoSProfile
from relay import stamped
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from sphere_nmpc.model.state import make_state
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.messages import clock_message, pose_to_ros

if TYPE_CHECKING:
    from fuzz import FuzzSession as Session

Try = Generator[None, None, None]
_JUMPS = (1.0, 10.0, 60.0, 600.0, 3600.0, 1e9)
"""Jumps of the clock [s]."""
_LARGEST_SHIFT = 10**9 * NANOSECONDS - 1
"""Offset of the robot's clock that remains after a try [ns]; stamps end at twice that."""
_AT_REST = 1e-2
"""Speed below which a rotor rests [rad/s]."""
_FAST = 20.0
"""Rotor speed that a controller shall have reached before its end [rad/s]."""
_ENDS_WITHIN = 15.0
"""Wall time within which a signal has to end a node [s]."""
_RESTS_WITHIN = {signal.SIGKILL: 12.0}
"""Simulated time after the end of a controller within which the rotors have to rest [s]."""
_RESTS_SOON = 0.5
"""The same after a signal that can be handled [s]."""
_ACCEPTING = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Fits every subscription."""


def lasting(seconds: float = math.inf) -> Try:
    """Last for a wall time [s], at least for a moment."""
    end = time.monotonic() + seconds
    yield
    while time.monotonic() < end:
        yield


def malformed(session: "Session", rng: random.Random) -> Try:
    """Malformed serialised messages on topics that a node subscribes to."""
    return messages(session, rng.sample(sorted(session.topics), 3), lambda topic: (
        damaged(rng, session.current_example(topic))
    ))


def extremes(session: "Session", rng: random.Random) -> Try:
    """Messages with extreme values on topics that a node subscribes to."""
    return messages(session, rng.sample(sorted(session.topics), 3), lambda topic: (
        extreme(rng, session.topics[topic], session.current_example(topic))
    ))


def messages(
    session: "Session", topics: Sequence[str], next_message: Callable[[str], bytes]
) -> Try:
    """Serialised messages on some topics, one after the other."""
    if "/simulator/push" in topics:  # some are valid: with that momentum no goal can be promised
        session.is_pushed = True
    with ExitStack() as made:
        publishers = [
            made.enter_context(session.publisher(session.topics[topic], topic, _ACCEPTING))
            for topic in topics
        ]
        while True:
            for topic, publisher in zip(topics, publishers, strict=True):
                with suppress(RuntimeError):  # longer than the middleware can send
                    publisher.publish(next_message(topic))
            yield


def parameters(session: "Session", rng: random.Random) -> Try:
    """Requests to set parameters to values of any type, and questions by hostile names."""
    session.is_pushed, session.judge.lenient_until = True, math.inf
    node = rng.choice(sorted(session.parameters))
    own = session.parameters[node]
    known = rng.choice((list(own), ["use_sim_time"]))
    while True:
        service = rng.choice(sorted(OF_PARAMETERS))
        names = [rng.choice([*known, *TEXTS[:3]]) for _ in range(rng.choice((1, 1, 5)))]
        given: dict[str, Any] = {"names": names + rng.sample(TEXTS, 3)}
        if service == "list_parameters":
            given = {"prefixes": names, "depth": rng.choice((0, 1, 2**64 - 1))}
        elif service.startswith("set"):
            values = [parameter_value(rng, own.get(name, ParameterValue())) for name in names]
            given = {"parameters": [
                ParameterMessage(name=name, value=value)
                for name, value in zip(names, values, strict=True)
            ]}
        session.ask(f"{node}/{service}", OF_PARAMETERS[service].Request(**given))
        yield


def services(session: "Session", rng: random.Random) -> Try:
    """Services of the nodes at random moments."""
    session.is_pushed, session.judge.lenient_until = True, math.inf
    while True:
        name = rng.choice(sorted(session.services))
        request = session.services[name].Request()
        if isinstance(request, SetBool.Request):
            request.data = rng.random() < 0.5
        session.ask(name, request)
        yield from lasting(rng.choice((0.0, 0.1, 0.5)))


def clock_jump(session: "Session", rng: random.Random) -> Try:
    """Jumps of the robot's clock, or wrong stamps of the clock or the poses alone."""
    relay = session.relay
    alone = rng.choice(("", "", "/clock", "pose"))
    by = round(rng.choice(_JUMPS) * NANOSECONDS)
    try:
        for _ in range(rng.choice((1, 3))):
            if alone:
                relay.forged[alone] += by if rng.random() < 0.7 else -by
            else:  # not to before zero
                back = min(by, session.judge.now + relay.shift)
                relay.shift += by if rng.random() < 0.7 else -back
            yield from lasting(rng.choice((0.3, 1.0, 2.0)))
        yield from lasting()
    finally:
        relay.forged.update(dict.fromkeys(relay.forged, 0))
        if relay.shift > _LARGEST_SHIFT:  # otherwise the clock stays as it is
            relay.shift = 0


def clock_forged(session: "Session", rng: random.Random) -> Try:
    """A second publisher of the clock, with another time or without a sensible one."""
    offset = rng.choice((*_JUMPS, -1.0, -60.0)) * NANOSECONDS
    fixed = rng.choice((None, None, None, 0, -NANOSECONDS, -(2**31) * NANOSECONDS, 2**61))
    period = rng.choice((0.0, 0.0005, 0.02, 0.5))
    due = 0.0
    with session.publisher(Clock, "/clock") as publisher:
        while True:
            for _ in range(1 if period else 20):
                if time.monotonic() < due:
                    break
                due = max(due, time.monotonic() - 0.01) + period
                now = session.judge.now + session.relay.shift + offset
                forged = stamped(clock_message(0), round(now) if fixed is None else fixed)
                publisher.publish(forged)
            yield


def ended(session: "Session", rng: random.Random) -> Try:
    """A signal that ends a node; after that of a controller the rotors have to come to rest."""
    name = rng.choice(("controller", *sorted(session.parameters)))
    number = signal.Signals(rng.choice((
        signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGKILL)))
    with session.publisher(PoseStamped, "/goal_pose") as publisher:
        if name == "controller":
            _set_in_motion(session, publisher, rng)
    session.expected.add(name)
    process = session.processes[name]
    process.send(number)
    if not session.until(lambda: process.code is not None, _ENDS_WITHIN):
        if session.alone:  # another fault may have stopped it
            session.fail("nodes that do not end", f"{name} {_ENDS_WITHIN:g} s after {number.name}")
        process.kill()
    if name == "controller" and session.alone:
        _judge_rest(session, number)
    yield


def _set_in_motion(session: "Session", publisher: Any, rng: random.Random) -> None:
    x = rng.choice((30.0, 1e6))
    goal = pose_to_ros(make_state((x, 0.0), (1.0, 0.0, 0.0, 0.0)), 0, RADIUS)
    publisher.publish(goal)
    session.until(lambda: session.judge.turning > _FAST, 15.0)
    session.until(lambda: False, rng.uniform(0.0, 6.0))  # by then a whole plan may be in force


def _judge_rest(session: "Session", number: signal.Signals) -> None:
    """Complain if the rotors turn for too long after the controller has ended."""
    judge, ended_at = session.judge, session.judge.now
    allowed = _RESTS_WITHIN.get(number, _RESTS_SOON)
    before = judge.turning
    session.until(lambda: judge.now > ended_at + allowed * NANOSECONDS, 3.0 * allowed)
    if judge.now > ended_at + allowed * NANOSECONDS and judge.turning > _AT_REST:
        session.fail("rolling on after the end", f"{judge.turning:.3f} rad/s {allowed:g} s after "
                     f"{number.name} of the controller, {before:.3f} rad/s at its end")


def worker(session: "Session", rng: random.Random) -> Try:
    """Signals that end or stop the process beside the controller, and its replacements."""
    number = rng.choice((signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM))
    signalled: set[int] = set()
    try:
        while True:
            signalled.add(pid := actions.worker_of(session.processes["controller"].pid))
            actions.send(pid, number)
            yield from lasting(0.5)
    finally:
        for pid in signalled:
            actions.send(pid, signal.SIGCONT)


def of_catalogue(*names: str) -> Callable[["Session", random.Random], Try]:
    """Return a try of one of some faults of the catalogue."""

    def attempt(session: "Session", rng: random.Random) -> Try:
        fault = FAULTS[rng.choice(names)]
        session.rng = np.random.default_rng(rng.getrandbits(32))
        action = fault.action(session, **fault.options)
        repeat = next(action)
        try:
            while True:
                if repeat is not None:
                    repeat()
                yield
        finally:
            next(action, None)

    return attempt


TRIES: dict[str, Callable[["Session", random.Random], Try]] = {
    function.__name__: function for function in (
        malformed, extremes, parameters, services, clock_jump, clock_forged, ended, worker,
    )
} | {
    "goals": of_catalogue("goal_burst", "goal_unreachable", "goal_malformed"),
    "lost": of_catalogue("clock_lost", "burst_poses", "burst_commands", "pose_future_10"),
    "stopped": of_catalogue("controller_stopped", "simulator_stopped"),
}
"""Tries by kind."""
