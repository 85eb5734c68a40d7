# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Node that no message, parameter, request or failed callback ends."""

import re
import traceback
from collections.abc import Callable, Generator
from concurrent.futures import Future
from contextlib import ExitStack
from functools import wraps
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock as NodeClock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future as RosFuture
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock
from type_description_interfaces.srv import GetTypeDescription

from sphere_nmpc.errors import (
    Description,
    InvalidInputError,
    InvalidValueError,
    SphereNmpcError,
    reason_of,
)
from sphere_nmpc.reporting.fault_log import EVENTS_EVERY, FaultLog
from sphere_nmpc.ros.cdr import clock_stamp
from sphere_nmpc.ros.messages import message_object
from sphere_nmpc.ros.parameters import Parameters

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS of topics of which only the newest message counts: a lost one does not delay it."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS of topics whose last message is sent to later subscribers, too."""
_TYPE_HASH = re.compile("RIHS01_[0-9a-f]{64}")
LONGEST_WAIT = 0.1
"""Longest wait in the middleware [s]; not every executor can be woken by a signal."""
FAILED = "callback failed"
"""Kind of fault of a timer, or of work beside the callbacks, that raised an error."""


class GuardedNode(Node):
    """Node whose callbacks never raise: an error is one line in the log, at most one in 5 s.

    rclpy passes errors of a callback, and of reading a message for it, on to whoever serves the
    executor, which is too late: by then its events executor has logged them as fatal, with their
    traceback, and has left out the messages that had arrived behind. So they are caught where
    rclpy is given the callback, which includes those of rclpy itself, for the clock and for
    parameters. Messages are read here too, as rclpy would read them outside the callback.

    It may have work of its own beside callbacks, and final messages to send; see `lifetime.run`.
    `parameter_overrides` are parameters as given on a command line, for use within a program.
    """

    uses_events_executor = False
    """Whether rclpy's events executor is preferred, for callbacks at a high rate."""

    def __init__(self, name: str, parameter_overrides: list[Parameter] | None = None) -> None:
        # Before the node is made, as rclpy creates services with it.
        self._fault_log = FaultLog(lambda line: self.get_logger().warning(line))
        self._event_log = FaultLog(lambda line: self.get_logger().info(line), EVENTS_EVERY)
        self.resources = ExitStack()
        """What ends with the node; from Kilted on, rclpy also destroys one that has not been made
        completely."""
        super().__init__(
            name, parameter_overrides=parameter_overrides,
            automatically_declare_parameters_from_overrides=True,
        )
        self.parameters = Parameters(self)
        """Where the node declares its settings."""
        for service in self.services:
            if service.srv_type is GetTypeDescription:  # rclpy makes this one in another way
                described = _for_valid_hash(service.callback)
                service.callback = self._answering(service.srv_name, described)

    def destroy_node(self) -> None:
        """Destroy the node and its resources."""
        self.resources.close()
        super().destroy_node()

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: Any,
        *,
        raw: bool = False,
        largest: tuple[int, str] | None = None,
        **options: Any,
    ) -> Subscription:
        """Create a subscription; see `rclpy.node.Node.create_subscription`.

        `largest` is the size [bytes] above which a message is refused before it is read, which
        takes the longer the more it has, and what that is enough for.
        """

        @wraps(callback)
        def take(message: bytes, *about: Any) -> None:
            try:
                if largest is not None and len(message) > largest[0]:
                    size = Description(f"{len(message)} bytes")
                    raise InvalidInputError(topic, size, f"at most {largest[1]}")
                if msg_type is Clock and not raw:
                    clock_stamp(message)  # rclpy would raise an error of its own before 0
                callback(message if raw else message_object(message, msg_type), *about)
            except Exception as error:
                self.report(f"{topic} refused", error)

        return super().create_subscription(msg_type, topic, take, qos_profile, raw=True, **options)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[..., Any], *more: Any, **options: Any
    ) -> Timer:
        """Create a timer; see `rclpy.node.Node.create_timer`."""
        return super().create_timer(
            timer_period_sec, self.guarded(FAILED, callback), *more, **options
        )

    def create_wall_timer(self, period: float, callback: Callable[..., Any]) -> Timer:
        """Create a timer of wall time [s], which runs where simulated time stands still, too."""
        steady = NodeClock(clock_type=ClockType.STEADY_TIME)
        return self.create_timer(period, callback, clock=steady)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **options: Any
    ) -> Service:
        """Create a service whose answer, where the callback fails, is a refusal with the reason.

        See `rclpy.node.Node.create_service`. A callback that returns a generator of futures is
        continued whenever one is done, and answers with what it returns; futures are to be done by
        the executor of the node, which goes on with other callbacks until then. The services of
        rclpy that set parameters answer by `Parameters.answer`.
        """
        if srv_type in (SetParameters, SetParametersAtomically):
            set_now = callback

            def callback(request: Any, response: Any) -> Any:
                return self.parameters.answer(set_now, request, response)

        answer = self._answering(srv_name, callback)
        service = super().create_service(srv_type, srv_name, answer, **options)
        send = service.send_response

        def send_when_known(response: Any, header: Any) -> None:
            if isinstance(response, Future):
                response.add_done_callback(
                    self.guarded(FAILED, lambda known: send(known.result(), header))
                )
            else:
                send(response, header)

        service.send_response = send_when_known  # type: ignore[method-assign]
        return service

    @property
    def thread_priority(self) -> int:
        """Real-time priority wanted for the node's threads; 0 is ordinary scheduling."""
        return 0

    def work(self, executor: Executor) -> None:
        """Do one piece of work; called repeatedly until the node is requested to end."""
        spin_for(executor, LONGEST_WAIT)

    def finish(self) -> None:
        """Send final messages; publishers still work, and signals no longer interrupt."""

    def guarded(self, kind: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return a callback that logs errors as a fault of this kind rather than raising them."""

        @wraps(callback)
        def call(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.report(kind, error)
                return None

        return call

    def _answering(self, name: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(callback)
        def answer(request: Any, response: Any) -> Any:
            def tried(step: Callable[[], Any]) -> Any:
                try:
                    return step()
                except Exception as error:
                    self.report(f"{name} refused", error)
                    return _refusal(request, response, reason_of(error))

            found = tried(lambda: callback(request, response))
            return _driven(found, tried) if isinstance(found, Generator) else found

        return answer

    def report(self, kind: str, error: Exception) -> None:
        """Log an error as a fault of this kind; one of another package with its place."""
        self._fault_log.report(kind, f"{reason_of(error)}{_place(error)}")


def spin_for(executor: Executor, duration: float) -> None:
    """Serve callbacks for a wall time [s]; the single-threaded executor serves one at most.

    Between two callbacks the events executor then does not return to Python, which takes as long
    as receiving a message; each call leaks 32 bytes within rclpy, so it is not for short waits.
    The other one could not be woken before the time has passed.
    """
    if isinstance(executor, SingleThreadedExecutor):
        executor.spin_once(timeout_sec=duration)
    else:
        executor.spin_until_future_complete(RosFuture(), timeout_sec=duration)


def _driven(
    steps: Generator[Future[Any], None, Any], tried: Callable[[Callable[[], Any]], Any]
) -> Any:
    """Return what a generator of futures returns, or a future of that where one is not done."""
    answer: Future[Any] = Future()

    def step() -> Any:
        try:
            return next(steps)
        except StopIteration as end:
            return end.value

    def go_on(_: object = None) -> None:
        found = tried(step)
        if isinstance(found, Future):
            found.add_done_callback(go_on)
        else:
            answer.set_result(found)

    go_on()
    return answer.result() if answer.done() else answer


def _for_valid_hash(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return the callback of a type description service; rcl logs an invalid hash as it is."""

    @wraps(callback)
    def answer(request: Any, response: Any) -> Any:
        if not _TYPE_HASH.fullmatch(request.type_hash):
            expected = "RIHS01_ and 64 hexadecimal digits"
            raise InvalidValueError("type_hash", request.type_hash, expected)
        return callback(request, response)

    return answer


def _place(error: Exception) -> str:
    """Return file and line of an error of another package, or of a mistake in this one."""
    if isinstance(error, SphereNmpcError) or error.__traceback__ is None:
        return ""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f" ({Path(last.filename).name}, line {last.lineno})"


def _refusal(request: Any, response: Any, reason: str) -> Any:
    """Return a response that refuses its request, as far as responses of its class can."""
    refused = SetParametersResult(successful=False, reason=reason)
    if hasattr(response, "results"):
        # One for each parameter: those before the one that failed have been set.
        left = len(request.parameters) - len(response.results) - 1
        untried = SetParametersResult(successful=False, reason="one before it was refused")
        response.results = [*response.results, refused, *[untried] * left]
    elif isinstance(getattr(response, "result", None), SetParametersResult):
        response.result = refused
    elif hasattr(response, "RESULT_UNDEFINED_FAILURE"):
        response.result = response.RESULT_UNDEFINED_FAILURE
    elif hasattr(response, "failure_reason"):
        response.failure_reason = reason
    elif hasattr(response, "message"):
        response.success, response.message = False, reason
    return response
