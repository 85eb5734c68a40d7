# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One child process: started, signalled, restarted and ended, with its output in a file."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sphere_nmpc.child import Process, end_together, how_it_ended, module_command
from sphere_nmpc.errors import SphereNmpcError

_STOPPING = (
    # A stopped process would not handle what follows.
    (signal.SIGCONT, 0.0), (signal.SIGINT, 6.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 2.0),
)
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
    """A child process ended unexpectedly."""

    def __init__(self, process: "ChildProcess") -> None:
        lines = process.output.splitlines()[-_LAST_LINES:]
        quoted = "\n".join(f"  {line}" for line in lines) or "  (no output)"
        super().__init__(f"unexpected end: {process.ending}; its last output:\n{quoted}")


class ChildProcess:
    """A command in a process group of its own, with its output in a file.

    It can be started again after its end; the log then continues. Signals go to the whole group,
    so that what the command has started is ended too, and a Ctrl-C of the terminal does not reach
    it: the parent decides when it ends.

    `name` is for messages, `command` is the program with its arguments, see `verb_command`. `log`
    takes standard error, and standard output unless `options` of `subprocess.Popen` redirect it;
    with `append` it keeps what an earlier object has written.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, append: bool = False, **options: Any
    ) -> None:
        self.name = name
        self.command = list(command)
        self.log = log
        self._append = append
        self._options = options
        self._process: Process | None = None

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
        if self._process is None or self._process.poll() is None:
            return f"{self.name} has not ended"
        return f"{self.name} ended, {how_it_ended(self._process)}"

    @property
    def output(self) -> str:
        """Content of its log so far."""
        return self.log.read_text(encoding="utf-8", errors="replace") if self.log.exists() else ""

    def start(self, extra: Sequence[str] = ()) -> None:
        """Start it with `extra` arguments; one that still runs is ended first."""
        self.stop()
        with self.log.open("ab" if self._append else "wb") as output:
            streams = {"stdin": subprocess.DEVNULL, "stdout": output, "stderr": output}
            self._process = subprocess.Popen(
                [*self.command, *extra], start_new_session=True, **{**streams, **self._options}
            )
        self._append = True

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process and to what it has started."""
        if self._process is not None and self._process.poll() is None:
            _signal_group(self._process, number)

    def wait(self, timeout: float) -> int:
        """Wait until it ends, at most for `timeout` [s], and return its exit code."""
        if self._process is None:
            raise ValueError(f"{self.name} was never started")
        return self._process.wait(timeout)

    def kill(self) -> None:
        """End it as ``kill -9`` does, and what it has started, even if it has ended itself."""
        if self._process is not None:
            _signal_group(self._process, signal.SIGKILL)
            self._process.wait(_KILLED_WITHIN)

    def stop(self) -> None:
        """End it: SIGINT first, then SIGTERM, then SIGKILL."""
        stop_together([self])

    def check(self) -> None:
        """Raise `ChildEndedError` if it has ended."""
        if self.code is not None:
            raise ChildEndedError(self)


def stop_together(processes: Sequence[ChildProcess]) -> None:
    """End several processes at the same time, and wait for their end."""
    started = [process._process for process in processes if process._process is not None]
    end_together(started, _STOPPING, _signal_group)


def _signal_group(process: Process, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)
