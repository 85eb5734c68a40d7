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
from collections.abc import Callable, Sequence

from sphere_nmpc.channel import Channel

TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP)
"""From a terminal to all processes that run in it: Ctrl-C, Ctrl-\\ and its end."""
END_SIGNALS = (*TERMINAL_SIGNALS, signal.SIGTERM)
"""Signals that ask a process to end, which all processes of this package treat alike."""
Process = subprocess.Popen[bytes]
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

    By default the child is of the same Python and imports from where this process does, and
    nowhere else; another `python` imports from its own path.
    """
    path = repr([os.path.abspath(entry) for entry in sys.path if entry])
    if python is not None:
        path = "[entry for entry in sys.path if entry]"  # '' is the working directory
    return [python or sys.executable, "-c", f"import sys; sys.path[:] = {path}; {program}",
            *arguments]


def end_with_parent(parent: int) -> None:
    """Let this process end when its parent, with this id, ends for whatever reason; Linux only."""
    if _PRCTL is not None:
        _PRCTL(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
        if os.getppid() != parent:
            sys.exit(1)


class Child:
    """A Python child with a channel: ``main`` of a module, given the descriptor of its end first.

    The signals of a terminal do not reach it in a session of its own. OSError is raised if the
    system allows no further process or channel.
    """

    def __init__(self, module: str, *arguments: str, own_session: bool = False) -> None:
        here, there = socket.socketpair()
        self.channel = Channel(here)
        try:
            self.process = subprocess.Popen(
                module_command(module, str(there.fileno()), *arguments), pass_fds=[there.fileno()],
                stdin=subprocess.DEVNULL, start_new_session=own_session,
            )
        except BaseException:
            here.close()
            raise
        finally:
            there.close()

    def end(self, patience: float = 0.0) -> str:
        """End it, gently if it has `patience` [s], and return how it ended."""
        if patience:
            self.process.terminate()
        self.channel.close()
        end_together([self.process], [(signal.SIGCONT, patience)])
        self.process.kill()
        self.process.wait()
        return how_it_ended(self.process)


def end_together(
    processes: Sequence[Process],
    steps: Sequence[tuple[signal.Signals, float]],
    send: Callable[[Process, signal.Signals], object] = subprocess.Popen.send_signal,
) -> None:
    """Send signals in turn to the processes that still run, and wait after each [s]."""
    for number, patience in steps:
        running = [process for process in processes if process.poll() is None]
        for process in running:
            send(process, number)
        end = time.monotonic() + patience
        for process in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, end - time.monotonic()))


def how_it_ended(process: Process) -> str:
    """Return the exit code, or the signal, of a process that has ended."""
    code = process.returncode
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"
