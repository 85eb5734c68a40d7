# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How a node starts, runs and ends, so that its last commands are sent whatever ends it.

rclpy's own signal handlers shut the context down before anybody could publish, and under
``ros2 launch`` a Ctrl-C arrives twice, from the terminal and from launch. So rclpy installs none;
a signal only asks the loop to end between two callbacks, and further ones change nothing.
"""

import contextlib
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.loopback import network_reach
from sphere_nmpc.ros.scheduling import refusal, schedule
from sphere_nmpc.ros.startup import one_line, start_ros

_LOOK_UP = 0.1
"""Longest wait in the middleware [s]; not every executor can be woken by a signal."""
_TURN = 5e-4
"""Longest turn of a thread beside the control loop [s]; rather than 5 ms."""
_STOPPING = (signal.SIGINT, signal.SIGTERM)
_OWN_CLOCK = ("--ros-args", "-r", "/clock:=clock")
"""In a namespace a robot has a clock of its own; a remapping that the user gives goes before."""


class LivingNode(Node):
    """A node that has something to do besides callbacks, or to say before it ends."""

    lean = False
    """Whether the node is called so often that its executor matters."""

    @property
    def thread_priority(self) -> int:
        """Real-time priority that the node's threads ask for; 0 is ordinary scheduling."""
        return 0

    def work(self, executor: Executor) -> None:
        """Do one piece of work; called over and over until the node is asked to end."""
        executor.spin_once(timeout_sec=_LOOK_UP)

    def finish(self) -> None:
        """Say the last words; publishers still work here and signals no longer interrupt."""


def run(make_node: Callable[[], LivingNode], args: Sequence[str] | None, about: str) -> int:
    """Run a node until SIGINT or SIGTERM, then let it finish.

    Parameters
    ----------
    make_node : callable
        Makes the node, with rclpy initialised.
    args : sequence of str or None
        Arguments after the program's name; those of the process by default.
    about : str
        What ``--help`` prints.

    Returns
    -------
    int
        0 after a signal; 2 for arguments, parameters and an environment that will not do, 1 where
        the node cannot be made for another reason; either is told in one line.
    """
    given = list(sys.argv[1:] if args is None else args)
    try:
        own = remove_ros_args(["node", *given])[1:]
    except Exception as error:  # rclpy's own types of error are private to it
        print(f"cannot start: {one_line(error)}", file=sys.stderr)
        return 2
    if "-h" in own or "--help" in own:
        print(about.strip())
        return 0
    if own:
        print(f"{own[0]}: not understood; parameters are given as\n{_HOW_TO}", file=sys.stderr)
        return 2
    try:
        start_ros([*given, *_OWN_CLOCK])
    except SphereNmpcError as error:
        print(f"cannot start: {error}", file=sys.stderr)
        return error.exit_code
    try:
        return _live(make_node)
    finally:
        rclpy.try_shutdown()


def _live(make_node: Callable[[], LivingNode]) -> int:
    with StopRequest() as stop:
        try:
            node = make_node()
        except (SphereNmpcError, ValueError, RuntimeError) as error:
            # rclpy's own reasons are a ValueError, as for a parameter that is given as {}, or a
            # RuntimeError of its own, as for a participant that cannot be made.
            rclpy.logging.get_logger("sphere_nmpc").fatal(one_line(error))
            return error.exit_code if isinstance(error, SphereNmpcError) else 1
        # What lives as long as the process need not be looked through again and again: a full
        # collection takes tens of milliseconds, longer than a sample at a high control rate.
        gc.collect()
        gc.freeze()
        if node.lean:
            sys.setswitchinterval(_TURN)
        executor = _make_executor(node.lean)
        if isinstance(executor, SingleThreadedExecutor):
            # The other one knows no guard conditions; it looks up often enough.
            stop.wake = node.create_guard_condition(lambda: None).trigger
        executor.add_node(node)
        node.get_logger().info(network_reach())
        try:
            priority = 0
            while not stop.requested:
                if node.thread_priority != priority:
                    priority = node.thread_priority
                    if not schedule(priority):
                        node.get_logger().warning(refusal(priority))
                node.work(executor)
        finally:
            # From here on nothing may interrupt: launch's second SIGINT arrives about now.
            for number in _STOPPING:
                signal.signal(number, signal.SIG_IGN)
            node.finish()
            executor.shutdown()
            node.destroy_node()
    return 0


class StopRequest:
    """Turns SIGINT and SIGTERM into a flag, and wakes a node that waits.

    The interpreter runs its signal handlers only between two of its own instructions, which a
    main thread that waits inside the middleware does not reach. The number of the signal is
    however written to a file descriptor at once, and a thread listens there.
    """

    def __init__(self) -> None:
        self.requested = False
        """True from the first signal on."""
        self.wake: Callable[[], object] | None = None
        """Wakes the executor; called when a signal comes."""

    def __enter__(self) -> "StopRequest":
        self._inlet, outlet = os.pipe()
        self._outlet = outlet
        os.set_blocking(outlet, False)
        self._earlier_fd = signal.set_wakeup_fd(outlet, warn_on_full_buffer=False)
        for number in _STOPPING:
            signal.signal(number, _do_nothing)
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        return self

    def __exit__(self, *exception: object) -> None:
        signal.set_wakeup_fd(self._earlier_fd)
        os.close(self._outlet)  # ends the listener
        self._listener.join()
        os.close(self._inlet)

    def _listen(self) -> None:
        while number := os.read(self._inlet, 1):
            if number[0] not in _STOPPING:
                continue
            self.requested = True
            if self.wake is not None:
                self.wake()
                return


def _make_executor(lean: bool) -> Executor:
    """Return rclpy's executor that is driven by events where there is one and it is wanted.

    The common one looks at every entity of the node before each callback, which takes longer than
    a whole control tick.
    """
    if lean:
        with contextlib.suppress(ImportError):
            from rclpy.experimental import EventsExecutor

            return EventsExecutor()
    return SingleThreadedExecutor()


def _do_nothing(number: int, frame: FrameType | None) -> None:
    """Let the signal be noted; the listener acts on it."""


_HOW_TO = "  --ros-args -p NAME:=VALUE ... --params-file FILE.yaml"
