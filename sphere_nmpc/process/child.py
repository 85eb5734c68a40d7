# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Child processes: their command lines, their start and their end."""

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.process.channel import Channel

TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP)
"""Signals from a terminal to all processes that run in it: Ctrl-C, Ctrl-\\ and its end."""
END_SIGNALS = (*TERMINAL_SIGNALS, signal.SIGTERM)
"""Signals that ask a process to end, which all processes of this package treat alike."""
_STOP_TIMEOUT = 6.0
"""Wait of `Child.stop` after SIGINT [s]."""
NICENESS = 5
"""Niceness of a process that only displays or searches, behind the control loop."""
_QUOTED_LINES = 12
"""Lines of output that a `ChildEndedError` quotes."""
_SET_PARENT_DEATH_SIGNAL = 1
# Loaded at once: between fork and exec the loader's lock may be held by a thread that is no more.
_PRCTL = ctypes.CDLL(None).prctl if sys.platform.startswith("linux") else None


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that calls ``main(arguments)`` of a module in a child process."""
    program = f"from {module} import main; sys.exit(main(sys.argv[1:]))"
    return python_command(program, *arguments)


def python_command(program: str, *arguments: str, python: str | None = None) -> list[str]:
    """Return the command line of a program of Python, for which `sys` is imported.

    With ``-m`` and ``-c`` Python looks for modules in the working directory first, so that a file
    ``random.py`` beside a bag would be executed. Its option ``-P`` prevents that, but Python 3.10
    does not have it, so the program sets its path before it imports anything else.

    By default the child is of the same Python, imports from where this process does and nowhere
    else, and ends with this process, see `begin_child`. Another `python` imports from its own
    path.
    """
    path = repr([os.path.abspath(entry) for entry in sys.path if entry])
    begin = f"from {__name__} import begin_child; begin_child({os.getpid()}); "
    if python is not None:
        path, begin = "[entry for entry in sys.path if entry]", ""  # '' is the working directory
    return [python or sys.executable, "-c", f"import sys; sys.path[:] = {path}; {begin}{program}",
            *arguments]


def begin_child(parent: int) -> None:
    """Let this process end on `END_SIGNALS`, and when its parent, with this id, ends.

    The latter is for whatever reason, on Linux only.
    """
    for number in END_SIGNALS:
        # A parent in the background of a script ignores some, and its children inherit that.
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    if _PRCTL is not None:
        _PRCTL(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
        if os.getppid() != parent:
            sys.exit(1)


class ChildEndedError(SphereNmpcError):
    """A child process ended unexpectedly."""

    def __init__(self, child: "Child") -> None:
        lines = child.output.splitlines()[-_QUOTED_LINES:]
        quoted = "\n".join(f"  {line}" for line in lines) or "  (no output)"
        super().__init__(f"unexpected end: {child.ending}; its last output:\n{quoted}")


class Child:
    """A command in a process group of its own, which can be started again after its end.

    Signals go to the whole group, so that what the command has started is ended too, and a Ctrl-C
    of the terminal does not reach it: the parent decides when it ends.

    Parameters
    ----------
    command : sequence of str
        The program with its arguments, see `module_command`.
    name : str
        What it is called in messages.
    log : Path, optional
        File of standard error, and of standard output unless `options` redirect it; a process that
        is started again continues it, and with `append` it keeps what an earlier object has
        written.
    with_channel : bool
        Whether the process is given a channel, the descriptor of its end as last argument.
    **options
        Those of `subprocess.Popen`.
    """

    channel: Channel
    """This end of the channel of a process that was started with one."""

    def __init__(
        self, command: Sequence[str], name: str = "process", log: Path | None = None,
        append: bool = False, with_channel: bool = False, **options: Any,
    ) -> None:
        self.command, self.name, self.log = list(command), name, log
        self._append, self._with_channel, self._options = append, with_channel, options
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        """Process id; 0 before it was started."""
        return 0 if self._process is None else self._process.pid

    @property
    def code(self) -> int | None:
        """Exit code, negative after a signal; None while it runs or before it was started."""
        return None if self._process is None else self._process.poll()

    @property
    def running(self) -> bool:
        """Whether it was started and has not ended."""
        return self._process is not None and self.code is None

    @property
    def ending(self) -> str:
        """Description of its end, with its exit code or the signal that ended it."""
        code = self.code
        if code is None:
            return f"{self.name} has not ended"
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{self.name} ended, {how}"

    @property
    def output(self) -> str:
        """Content of its log so far."""
        if self.log is None or not self.log.exists():
            return ""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def start(self, *arguments: str) -> "Child":
        """Start the process with further arguments; one that still runs is ended first.

        OSError is raised if the system allows no further process or channel.
        """
        self.stop()
        options: dict[str, Any] = {"stdin": subprocess.DEVNULL}
        command = [*self.command, *arguments]
        with contextlib.ExitStack() as exits:
            if self.log is not None:
                log = exits.enter_context(self.log.open("ab" if self._append else "wb"))
                options |= {"stdout": log, "stderr": log}
            if self._with_channel:
                here, there = map(exits.enter_context, socket.socketpair())
                options["pass_fds"] = [there.fileno()]
                command.append(str(there.fileno()))
            options |= self._options
            self._process = subprocess.Popen(command, start_new_session=True, **options)
            if self._with_channel:
                self.channel = Channel(here.dup())
        self._append = True
        return self

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process, while it runs, and to what it has started."""
        if self.running:
            self._signal(number)

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it ends, at most for `timeout` [s], and return its exit code."""
        if self._process is None:
            raise ValueError(f"{self.name} was never started")
        return self._process.wait(timeout)

    def kill(self) -> None:
        """End the process as ``kill -9`` does, and what it has started, even if it is over."""
        if self._process is not None:
            self._signal(signal.SIGKILL)
            self.stop(0.0)

    def stop(self, patience: float = _STOP_TIMEOUT) -> None:
        """End the process; see `stop_together`."""
        stop_together([self], patience)

    def check(self) -> None:
        """Raise `ChildEndedError` if it has ended."""
        if self.code is not None:
            raise ChildEndedError(self)

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)


def stop_together(children: Sequence[Child], patience: float = _STOP_TIMEOUT) -> None:
    """End processes at the same time, and wait for their end.

    They are asked to by SIGINT or, where there is a channel, by closing it; after `patience` [s]
    by SIGTERM, and after half of that they are killed.
    """
    for child in children:
        child.send(signal.SIGCONT)  # one that is stopped would not handle what follows
        if not child._with_channel:
            child.send(signal.SIGINT)
        elif child.pid:
            child.channel.close()
    for longest, number in ((patience, signal.SIGTERM), (0.5 * patience, signal.SIGKILL)):
        end = time.monotonic() + longest
        running = [child for child in children if child.running]
        for child in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(max(0.0, end - time.monotonic()))
        for child in running:
            child.send(number)
    for child in children:
        if child.pid:
            child.wait()
