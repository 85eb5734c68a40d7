# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Start, run and end of a node's process, so that final commands are sent whatever ends it.

rclpy's own signal handlers shut the context down before a node could publish, and under
``ros2 launch`` a Ctrl-C arrives twice, from the terminal and from launch. So rclpy installs none;
a signal only requests the loop to end between two callbacks, and further signals are ignored.
"""

import contextlib
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor

from sphere_nmpc.errors import EndingError, SphereNmpcError, shown
from sphere_nmpc.foreign.code import allow_calls, end_calls, is_called, on_signal
from sphere_nmpc.process.child import END_SIGNALS, NICENESS
from sphere_nmpc.ros.guarded_node import FAILED, GuardedNode
from sphere_nmpc.ros.network import network_reach
from sphere_nmpc.ros.startup import one_line, start_ros, without_ros_arguments

_PATIENCE = 1.0
"""Wall time after a request to end for which a call of foreign code is waited for [s]."""
_AFTER_FAILURE = 1e-3
"""Pause after work that failed [s], which may fail each time; shorter than a control tick."""
_SWITCH_INTERVAL = 5e-4
"""Longest time for which another thread keeps the interpreter from the control loop [s]."""
_YOUNG_EVERY = 0.25
"""Time between two collections of new objects [s], each of which takes some 0.1 ms."""
_ALL_EVERY = 300.0
"""Time between two collections of all objects made since the start [s]."""
_MIDDLE, _OLDEST = 1, 2
"""Generations of objects, as the garbage collector counts them."""
_TASKS = Path("/proc/self/task")
_OF_SESSION = Path("/proc/self/autogroup")
_OWN_CLOCK = ("--ros-args", "-r", "/clock:=clock")
"""In a namespace a robot has its own clock; a remapping given by the user takes precedence."""
_ABOUT_PARAMETERS = """\
Parameters are given with --ros-args -p NAME:=VALUE or --params-file FILE.yaml;
msg_docs/parameters.md lists them."""
"""End of what ``--help`` prints of any node."""


def run(make_node: Callable[[], GuardedNode], args: Sequence[str] | None, about: str) -> int:
    """Run a node until a signal asks it to end, see `END_SIGNALS`, then let it finish.

    `make_node` is called with rclpy initialised, `args` are those after the program's name,
    `about` is how ``--help`` begins. Returns 0 after a signal; 2 for wrong arguments, parameters
    or environment variables, 1 if the node cannot be made for another reason or its work raises
    an `EndingError`; the reason is printed in one line.
    """
    given = list(sys.argv[1:] if args is None else args)
    try:
        own = without_ros_arguments(given)
        if not own:
            start_ros([*given, *_OWN_CLOCK])
    except SphereNmpcError as error:
        print(f"cannot start: {error}", file=sys.stderr)
        return error.exit_code
    if "-h" in own or "--help" in own:
        print(f"{about.strip()}\n\n{_ABOUT_PARAMETERS}")
        return 0
    if own:
        how = "  --ros-args -p NAME:=VALUE ... --params-file FILE.yaml"
        print(f"{own[0]}: not understood; parameters are given as\n{how}", file=sys.stderr)
        return 2
    earlier = threading.enumerate()
    try:
        code = _run_until_signal(make_node)
    finally:
        rclpy.try_shutdown()
    _leave_threads(earlier, code)
    return code


def _leave_threads(earlier: Sequence[threading.Thread], code: int) -> None:
    """End the process by a code where threads of other packages run, which it would wait for."""
    end = time.monotonic() + _PATIENCE
    for thread in threading.enumerate():
        if thread not in earlier and not thread.daemon:
            thread.join(max(0.0, end - time.monotonic()))
            if thread.is_alive():
                print(f"thread {shown(thread.name)} of another package is left behind, given no "
                      "end, expected one that is a daemon", file=sys.stderr, flush=True)
                sys.stdout.flush()
                os._exit(code)


def _run_until_signal(make_node: Callable[[], GuardedNode]) -> int:
    with StopRequest() as stop:
        try:
            node = make_node()
        except (SphereNmpcError, ValueError, RuntimeError) as error:
            # rclpy's own reasons are a ValueError, as for a parameter that is given as {}, or a
            # RuntimeError of its own, as for a participant that cannot be made.
            rclpy.logging.get_logger("sphere_nmpc").fatal(one_line(error))
            return error.exit_code if isinstance(error, SphereNmpcError) else 1
        if node.uses_events_executor:
            sys.setswitchinterval(_SWITCH_INTERVAL)
        executor = _make_executor(node.uses_events_executor)
        if isinstance(executor, SingleThreadedExecutor):
            # The events executor has no guard conditions; it returns after `LONGEST_WAIT`.
            stop.wake = node.create_guard_condition(lambda: None).trigger
        executor.add_node(node)
        stop.finish = node.finish
        node.get_logger().info(network_reach())
        try:
            priority = 0
            with _collected_garbage() as collect_if_due:
                while not stop.requested:
                    if node.thread_priority != priority:
                        priority = node.thread_priority
                        if not schedule(priority):
                            node.get_logger().warning(
                                f"thread_priority: given {priority}, but this user may not "
                                "schedule in real time, expected root, CAP_SYS_NICE or rtprio in "
                                "/etc/security/limits.conf; continuing with ordinary scheduling"
                            )
                    try:
                        node.work(executor)
                    except EndingError as error:
                        node.get_logger().fatal(one_line(error))
                        return error.exit_code
                    except Exception as error:  # one line in the log, as one of its callbacks
                        node.report(FAILED, error)
                        time.sleep(_AFTER_FAILURE)
                    collect_if_due()
        finally:
            # Launch's second SIGINT arrives about now; no signal interrupts the final messages.
            node.finish()
            executor.shutdown()
            node.destroy_node()
    return 0


class StopRequest:
    """Flag that `END_SIGNALS` set, and that wakes a node which waits.

    The interpreter runs signal handlers between two of its own instructions, which a main thread
    that waits inside the middleware does not reach. The number of the signal is however written
    to a file descriptor immediately, and a thread reads it there. A SIGHUP that is ignored from
    the start, as by ``nohup``, stays ignored.

    That thread also ends calls of foreign code that keep the node from ending: they are
    interrupted, and one that goes on nevertheless is left behind, with the final messages sent.
    """

    def __init__(self) -> None:
        self.requested = False
        """True from the first signal on."""
        self.wake: Callable[[], object] | None = None
        """Wakes the executor; called when a signal arrives."""
        self.finish: Callable[[], object] | None = None
        """Sends the final messages, where a call of foreign code does not end."""
        self._ended = threading.Event()

    def __enter__(self) -> "StopRequest":
        allow_calls()
        self._inlet, outlet = os.pipe()
        self._outlet = outlet
        os.set_blocking(outlet, False)
        self._earlier_fd = signal.set_wakeup_fd(outlet, warn_on_full_buffer=False)
        for number in END_SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, on_signal)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        return self

    def __exit__(self, *exception: object) -> None:
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        self._ended.set()
        signal.set_wakeup_fd(self._earlier_fd)
        os.close(self._outlet)  # ends the reader
        self._reader.join()
        os.close(self._inlet)

    def _read(self) -> None:
        while number := os.read(self._inlet, 1):
            if number[0] not in END_SIGNALS:
                continue
            self.requested = True
            if self.wake is not None:
                self.wake()
            for end in (end_calls, self._leave):
                while not self._ended.wait(_PATIENCE):
                    if is_called():
                        end()
                        break
            return

    def _leave(self) -> None:
        """Send the final messages, and end the process with its main thread in foreign code."""
        log = rclpy.logging.get_logger("sphere_nmpc")
        log.fatal("code of another package does not return, and is left behind")
        try:
            if self.finish is not None:
                self.finish()
        finally:
            os._exit(1)


def _make_executor(by_events: bool) -> Executor:
    """Return rclpy's events executor if it is wanted and exists, else the single-threaded one.

    The latter checks every entity of the node before each callback, which takes longer than a
    whole control tick.
    """
    if by_events:
        with contextlib.suppress(ImportError):
            from rclpy.experimental import EventsExecutor

            return EventsExecutor()
    return SingleThreadedExecutor()


@contextlib.contextmanager
def _collected_garbage() -> Iterator[Callable[[], None]]:
    """Return a function that collects garbage if that is due, which does not happen otherwise.

    Almost everything is freed by its reference count; the collector only finds cycles. Left to
    itself it looks at all objects made since the start every few seconds, in the middle of a
    sample, for longer than a control period of 2 ms.
    """
    young_at = all_at = time.monotonic()

    def collect_if_due() -> None:
        nonlocal young_at, all_at
        now = time.monotonic()
        if now >= young_at + _YOUNG_EVERY:
            young_at = now
            is_full = now >= all_at + _ALL_EVERY
            all_at = now if is_full else all_at
            gc.collect(_OLDEST if is_full else _MIDDLE)

    # Objects that exist as long as the process are excluded: with them a full collection takes
    # tens of milliseconds.
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield collect_if_due
    finally:
        gc.enable()
        gc.unfreeze()


def schedule(priority: int) -> bool:
    """Schedule all threads with a priority of SCHED_FIFO, 1 to 99, or ordinarily, 0.

    It needs Linux and root, CAP_SYS_NICE or `rtprio` in limits.conf; otherwise nothing changes.
    Returns whether it was allowed.
    """
    try:
        policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
        wanted = os.sched_param(priority)
        # Each thread has its own policy, and the middleware has started some.
        for task in _TASKS.iterdir():
            os.sched_setscheduler(int(task.name), policy, wanted)
    except (OSError, AttributeError):
        return False
    return True


def lower_priority() -> None:
    """Give this process a lower priority than the nodes in the control loop.

    Between sessions Linux divides processor time by the niceness of the session.
    """
    os.nice(NICENESS)
    with contextlib.suppress(OSError):
        if os.getsid(0) == os.getpid():
            _OF_SESSION.write_text(str(NICENESS))
