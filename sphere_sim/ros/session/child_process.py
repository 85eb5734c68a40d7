# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One child process: started, signalled, restarted and ended, with its output in a file."""

import contextlib
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from sphere_nmpc.child_command import module_command
from sphere_nmpc.end_signals import END_SIGNALS
from sphere_nmpc.errors import SphereNmpcError

_STOPPING = ((signal.SIGINT, 6.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 2.0))
"""Signals that end a process, in this order, and the wait after each [s]."""
_KILLED_WITHIN = 5.0
"""Longest wait for a process after SIGKILL [s]."""
_LAST_LINES = 12


def verb_command(verb: str, *arguments: str) -> list[str]:
    """Return the command line of ``sphere_nmpc VERB ARGUMENTS`` as a child of this process.

    The process ends when this one ends, for whatever reason.
    """
    return module_command("sphere_sim.cli.child", str(os.getpid()), verb, *arguments)


def parameter_options(parameters: Mapping[str, object]) -> list[str]:
    """Return the ROS arguments ``-p NAME:=VALUE`` of parameters."""
    texts = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in parameters.items()
    }
    return [part for name, text in texts.items() for part in ("-p", f"{name}:={text}")]


class ChildEndedError(SphereNmpcError):
    """A child process ended unexpectedly.

    Parameters
    ----------
    process : ChildProcess
        The process, which has ended.
    """

    def __init__(self, process: "ChildProcess") -> None:
        lines = process.output.splitlines()[-_LAST_LINES:]
        quoted = "\n".join(f"  {line}" for line in lines) or "  (no output)"
        super().__init__(f"unexpected end: {process.ending}; its last output:\n{quoted}")


class ChildProcess:
    """A command in a process group of its own, with its output in a file.

    It can be started again after its end; the log then continues. Signals go to the whole group,
    so that what the command has started is ended too, and a Ctrl-C of the terminal does not reach
    it: the parent decides when it ends. Signals that the parent ignores, as in the background of a
    script, have their default action in the child.

    Parameters
    ----------
    name : str
        For messages.
    command : sequence of str
        Program and arguments, see `verb_command`.
    log : Path
        File for standard error, and for standard output unless `options` redirect it.
    append : bool, optional
        Whether to keep what an earlier object has written to the log.
    **options
        Further arguments of `subprocess.Popen`, such as ``stdout``, ``env`` or ``cwd``.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, append: bool = False, **options: Any
    ) -> None:
        self.name = name
        self.command = list(command)
        self.log = log
        self._append = append
        self._options = options
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        """Its process id; 0 before it was started."""
        return 0 if self._process is None else self._process.pid

    @property
    def code(self) -> int | None:
        """Its exit code, negative after a signal; None while it runs or before it was started."""
        return None if self._process is None else self._process.poll()

    @property
    def running(self) -> bool:
        """Whether it was started and has not ended."""
        return self._process is not None and self._process.poll() is None

    @property
    def ending(self) -> str:
        """Description of its end."""
        code = self.code
        if code is None:
            return f"{self.name} has not ended"
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{self.name} ended, {how}"

    @property
    def output(self) -> str:
        """Content of its log so far."""
        return self.log.read_text(encoding="utf-8", errors="replace") if self.log.exists() else ""

    @property
    def tracebacks(self) -> int:
        """Number of unexpected errors in its log, each of which is logged with its place."""
        return len(re.findall(r"Traceback \(most recent|\.py, line \d+\)", self.output))

    def start(self, extra: Sequence[str] = ()) -> None:
        """Start it with `extra` arguments; one that still runs is ended first."""
        self.stop()
        with self.log.open("ab" if self._append else "wb") as output:
            streams = {"stdin": subprocess.DEVNULL, "stdout": output, "stderr": output}
            with _default_in_children():
                self._process = subprocess.Popen(
                    [*self.command, *extra], start_new_session=True, **{**streams, **self._options}
                )
        self._append = True

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process and to what it has started."""
        if self._process is not None and self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)

    def wait(self, timeout: float) -> int:
        """Wait until it ends and return its exit code.

        Raises
        ------
        subprocess.TimeoutExpired
            If it runs for longer than `timeout` [s].
        """
        if self._process is None:
            raise ValueError(f"{self.name} was never started")
        return self._process.wait(timeout)

    def kill(self) -> None:
        """End it as ``kill -9`` does, and what it has started, even if it has ended itself."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait(_KILLED_WITHIN)

    def stop(self) -> None:
        """End it: SIGINT first, then SIGTERM, then SIGKILL."""
        stop_together([self])

    def check(self) -> None:
        """Raise if it has ended.

        Raises
        ------
        ChildEndedError
            With the last lines of its output.
        """
        if self.code is not None:
            raise ChildEndedError(self)


def stop_together(processes: Sequence[ChildProcess]) -> None:
    """End several processes at the same time, and wait for their end."""
    for process in processes:
        process.send(signal.SIGCONT)  # a stopped process would not handle what follows
    for number, patience in _STOPPING:
        running = [process for process in processes if process.running]
        for process in running:
            process.send(number)
        end = time.monotonic() + patience
        for process in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, end - time.monotonic()))


@contextlib.contextmanager
def _default_in_children() -> Iterator[None]:
    """Handle, without effect, signals that this process ignores.

    A child inherits ignored signals and would ignore the request to end; handled ones have their
    default action in it.
    """
    may_change = threading.current_thread() is threading.main_thread()
    ignored = [n for n in END_SIGNALS if may_change and signal.getsignal(n) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, lambda *_: None)
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)
