# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands of this package in a home folder of their own, with altered environment and limits."""

import contextlib
import os
import resource
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from sphere_sim.ros.session.child_process import ChildProcess, verb_command

TIMEOUT = 240.0
"""How long a command may take [s]; on a busy machine without a compiler a short study needs 60."""
_DROPPED = ("CC", "XDG_CACHE_HOME", "ROS_LOG_DIR", "ROS_HOME", "MPLCONFIGDIR")
"""Variables of the user's that would lead out of the scratch home."""
_CACHE = "SPHERE_NMPC_CACHE"
_COMPILING = "compiling the solver"
"""Part of a line that the first command of a home may print in addition."""

Limits = Mapping[int, int]
"""Resource of `resource.setrlimit` -> its limit."""


@dataclass(frozen=True)
class CommandResult:
    """Outcome of a command.

    Attributes
    ----------
    code : int
        Its exit code.
    errors : str
        Its standard error.
    seconds : float
        Duration of the command; after an interrupt, counted from there.
    """

    code: int
    errors: str
    seconds: float

    def complaints(self, code: int, *words: str, lines: int | None = None) -> list[str]:
        """Return the differences from the expected end.

        Parameters
        ----------
        code : int
            Expected exit code.
        *words : str
            Texts expected on standard error.
        lines : int, optional
            Expected number of lines on standard error; any by default.
        """
        printed = [line for line in self.errors.splitlines() if line and _COMPILING not in line]
        found = []
        if self.code != code:
            found.append(f"exit code {self.code}, expected {code}: {' | '.join(printed[-3:])}")
        if "Traceback" in self.errors:
            found.append(f"a traceback: {printed[-1]}")
        found += [f"'{word}' was not printed" for word in words if word not in self.errors]
        if lines is not None and len(printed) != lines:
            last = " | ".join(printed[-3:])
            found.append(f"printed {len(printed)} lines, expected {lines}: {last}")
        return found


class ScratchHome:
    """A home, a cache and a temporary folder for commands; the compiled solver is kept there.

    Parameters
    ----------
    folder : Path
        Empty folder for all of it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._number = 0
        for name in ("home", "cache", "tmp", "work"):
            (folder / name).mkdir(parents=True, exist_ok=True)

    def fresh(self, name: str = "out") -> Path:
        """Return a path in the scratch folder at which there is nothing yet."""
        self._number += 1
        return self.folder / f"{name}_{self._number}"

    def environment(self, changes: Mapping[str, str | None]) -> dict[str, str]:
        """Return the environment of a command; a change to None removes a variable."""
        own = {k: v for k, v in os.environ.items() if k not in _DROPPED}
        own |= {"HOME": str(self.folder / "home"), "TMPDIR": str(self.folder / "tmp")}
        # Bytecode that a limit of file sizes truncates would break each later start.
        own |= {_CACHE: str(self.folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        own |= {name: value for name, value in changes.items() if value is not None}
        return {k: v for k, v in own.items() if changes.get(k, v) is not None}

    @contextlib.contextmanager
    def running(
        self,
        words: list[str],
        environment: Mapping[str, str | None] | None = None,
        limits: Limits | None = None,
        output: int | Path = subprocess.DEVNULL,
    ) -> Iterator["RunningCommand"]:
        """Run ``sphere_nmpc WORDS`` until the context is left.

        Parameters
        ----------
        words : list of str
            The verb and its arguments.
        environment : mapping, optional
            Changed variables; None removes one.
        limits : mapping, optional
            Limits of resources.
        output : int or Path, optional
            Where standard output goes; it is discarded by default.
        """
        with contextlib.ExitStack() as files:
            target = files.enter_context(output.open("wb")) if isinstance(output, Path) else output
            process = ChildProcess(
                words[0], verb_command(*words), self.fresh("stderr"), stdout=target,
                cwd=self.folder / "work", env=self.environment(environment or {}),
                preexec_fn=_limiting(limits or {}),
            )
            process.start()
            try:
                yield RunningCommand(process)
            finally:
                process.kill()

    def run(
        self,
        words: list[str],
        environment: Mapping[str, str | None] | None = None,
        limits: Limits | None = None,
        output: int | Path = subprocess.DEVNULL,
    ) -> CommandResult:
        """Run a command to its end; parameters as in `running`."""
        with self.running(words, environment, limits, output) as command:
            return command.result()


class RunningCommand:
    """A command that runs.

    Parameters
    ----------
    process : ChildProcess
        Its process, whose log is standard error alone.
    """

    def __init__(self, process: ChildProcess) -> None:
        self._process = process
        self._began = time.monotonic()

    def wait_for(self, condition: Callable[[], bool], timeout: float = TIMEOUT) -> bool:
        """Wait until a condition holds; return whether it came to hold before the end."""
        end = time.monotonic() + timeout
        while not condition():
            if not self._process.running or time.monotonic() > end:
                return condition()
            time.sleep(0.05)
        return True

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def errors(self) -> str:
        """Its output to standard error so far."""
        return self._process.output

    def interrupt(self) -> None:
        """Send SIGINT to the whole process group, as Ctrl-C in a terminal does."""
        self._began = time.monotonic()
        self._process.send(signal.SIGINT)

    def result(self, timeout: float = TIMEOUT) -> CommandResult:
        """Wait for the end; a command that takes too long is killed, which its code shows."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)
        self._process.kill()
        code = self._process.wait(0.0)
        return CommandResult(code, self.errors, time.monotonic() - self._began)


def _limiting(limits: Limits) -> Callable[[], None] | None:
    if not limits:
        return None

    def limit() -> None:
        for kind, most in limits.items():
            resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))

    return limit
