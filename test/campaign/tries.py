# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Hostile faults of the fuzzing: what anybody on the network can send to the nodes.

They are generators as those of `actions`, drawn by the random numbers of a trial.
"""

import signal
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any

from actions import Action, every, source
from bad_strategy import FOREIGN
from hostile import TEXTS, damaged, extreme, parameter_value
from node_session import Session, SessionError
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool

from sphere_nmpc.quantities import NANOSECONDS

_JUMPS = (1.0, 10.0, 60.0, 600.0, 3600.0, 1e9)
"""Jumps of the clock [s]."""
_LARGEST_SHIFT = 10**9 * NANOSECONDS - 1
"""Offset of the robot's clock that remains after a fault [ns]; stamps end at twice that."""
_AT_REST = 1e-2
"""Speed below which a rotor rests [rad/s]."""
_ENDS_WITHIN = 15.0
"""Wall time within which a signal has to end a node [s]."""
_RESTS_WITHIN = {signal.SIGKILL: 12.0}
"""Simulated time after the end of a controller within which the rotors have to rest [s]."""
_RESTS_SOON = 0.5
"""The same after a signal that can be handled [s]."""
ACCEPTING = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Fits every subscription."""


def malformed(session: Session) -> Action:
    """Malformed serialised messages on topics that a node subscribes to."""
    rng = source(session)
    return messages(session, rng.sample(sorted(session.topics), 3), lambda topic: (
        damaged(rng, session.current_example(topic))
    ))


def extremes(session: Session) -> Action:
    """Messages with extreme values on topics that a node subscribes to."""
    rng = source(session)
    return messages(session, rng.sample(sorted(session.topics), 3), lambda topic: (
        extreme(rng, session.topics[topic], session.current_example(topic))
    ))


def messages(
    session: Session, topics: Sequence[str], next_message: Callable[[str], bytes]
) -> Action:
    """Serialised messages on some topics, one after the other."""
    with session.restored(), ExitStack() as made:
        publishers = {
            topic: made.enter_context(session.publisher(session.topics[topic], topic, ACCEPTING))
            for topic in topics
        }

        def publish() -> None:
            for topic, publisher in publishers.items():
                with suppress(RuntimeError):  # longer than the middleware can send
                    publisher.publish(next_message(topic))

        yield publish


def parameters(session: Session) -> Action:
    """Requests to set parameters to values of any type, and questions by hostile names."""
    rng = source(session)
    node = rng.choice(sorted(session.parameters))
    own = session.parameters[node]
    known = rng.choice((list(own), ["use_sim_time"]))
    asked = ("list_parameters", "get_parameters", "get_parameter_types", "describe_parameters",
             "set_parameters", "set_parameters_atomically")

    def ask() -> None:
        service = f"{node}/{rng.choice(asked)}"
        names = [rng.choice([*known, *TEXTS[:3]]) for _ in range(rng.choice((1, 1, 5)))]
        given: dict[str, Any] = {"names": names + rng.sample(TEXTS, 3)}
        if service.endswith("/list_parameters"):
            given = {"prefixes": names, "depth": rng.choice((0, 1, 2**64 - 1))}
        elif "/set_" in service:
            values = [parameter_value(rng, own.get(name, ParameterValue())) for name in names]
            given = {"parameters": [
                ParameterMessage(name=name, value=value)
                for name, value in zip(names, values, strict=True)
            ]}
        session.ask(service, session.services[service].Request(**given))

    with session.restored():
        yield ask


def services(session: Session) -> Action:
    """Services of the nodes at random moments."""
    rng = source(session)
    # Not of the recorder: a bag of an instant has no pose.
    names = [name for name, kind in session.services.items()
             if "std_srvs" in kind.__module__ and not name.startswith("recorder/")]

    def ask() -> float:
        period, name = rng.choice((0.0, 0.1, 0.5)), rng.choice(names)
        request = session.services[name].Request()
        if isinstance(request, SetBool.Request):
            request.data = rng.random() < 0.5
        session.ask(name, request)
        return period

    with session.restored():
        yield every(0.0, ask)


def strategies(session: Session) -> Action:
    """Strategies of other packages, each of which fails in a way of its own, and what is usual."""
    rng, service = source(session), "controller/set_parameters"
    names = [*(f"foreign_{way}" for way in FOREIGN), session.settings.strategy]

    def ask() -> float:
        wanted = Parameter("strategy", value=rng.choice(names)).to_parameter_msg()
        session.ask(service, session.services[service].Request(parameters=[wanted]))
        return rng.choice((0.1, 0.5, 1.0))

    with session.restored():
        yield every(0.0, ask)


def clock_jump(session: Session) -> Action:
    """Jump of the robot's clock, which stays, or wrong stamps of the clock or the poses alone."""
    relay, rng = session.relay, source(session)
    alone, by = rng.choice(("", "/clock", "pose")), round(rng.choice(_JUMPS) * NANOSECONDS)
    if alone:
        relay.forged[alone] = rng.choice((by, -by))
    else:
        relay.shift += by
        session.judge.limits.restart()
    yield
    relay.forged.update(dict.fromkeys(relay.forged, 0))
    if relay.shift > _LARGEST_SHIFT:
        relay.shift = 0
        session.judge.limits.restart()


def ended(session: Session) -> Action:
    """A signal that ends a node; after that of a controller the rotors have to come to rest."""
    rng = source(session)
    name = rng.choice(("controller", *session.nodes))
    number = signal.Signals(rng.choice((
        signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGKILL)))
    process, judge = session.processes[name], session.judge
    try:
        process.send(number)
        if not session.until(lambda: process.code is not None, _ENDS_WITHIN):
            process.kill()
            raise SessionError(f"{name} does not end {_ENDS_WITHIN:g} s after {number.name}")
        if name == "controller":
            allowed = _RESTS_WITHIN.get(number, _RESTS_SOON)
            due = judge.now + allowed * NANOSECONDS
            if session.until(lambda: judge.now > due, 3.0 * allowed) and judge.turning > _AT_REST:
                raise SessionError(f"rotors turn at {judge.turning:.3f} rad/s {allowed:g} s after "
                                   f"{number.name} of the controller")
        yield
    finally:
        session.start(name)
