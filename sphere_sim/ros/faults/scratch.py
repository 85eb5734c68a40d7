# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands of this package in a home folder of their own, on a machine that lacks something."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

TIMEOUT = 240.0
"""How long a command may take [s]; on a busy machine without a compiler a short study needs 60."""
_DROPPED = ("CC", "XDG_CACHE_HOME", "ROS_LOG_DIR", "ROS_HOME", "MPLCONFIGDIR")
"""Variables of the user's that would lead out of the scratch home."""
_CACHE = "SPHERE_NMPC_CACHE"
_COMPILING = "compiling the solver"
"""A line that the first command of a home may print besides."""

Limits = Mapping[int, int]
"""Resource of `resource.setrlimit` -> its limit."""


@dataclass(frozen=True)
class Ended:
    """A command that has ended.

    Attributes
    ----------
    code : int
        Its exit code.
    told : str
        Its standard error.
    seconds : float
        How long it took; after a signal, counted from there.
    """

    code: int
    told: str
    seconds: float

    def faults(self, code: int, *words: str, lines: int | None = None) -> list[str]:
        """Return what differs from an end with `code` that told `words` in some `lines`."""
        told = [line for line in self.told.splitlines() if line and _COMPILING not in line]
        found = []
        if self.code != code:
            found.append(f"exit code {self.code}, expected {code}: {' | '.join(told[-3:])}")
        if "Traceback" in self.told:
            found.append(f"a traceback: {told[-1]}")
        found += [f"nothing told '{word}'" for word in words if word not in self.told]
        if lines is not None and len(told) != lines:
            found.append(f"told {len(told)} lines, expected {lines}: {' | '.join(told[-3:])}")
        return found


class ScratchHome:
    """A home, a cache and a temporary folder of their own; the compiled solver is kept there.

    Parameters
    ----------
    folder : Path
        Empty; everything goes there.
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
        """Return the variables of a command; None takes one away."""
        own = {k: v for k, v in os.environ.items() if k not in _DROPPED}
        own |= {"HOME": str(self.folder / "home"), "TMPDIR": str(self.folder / "tmp")}
        own |= {_CACHE: str(self.folder / "cache")}
        own |= {name: value for name, value in changes.items() if value is not None}
        return {k: v for k, v in own.items() if changes.get(k, v) is not None}

    @contextlib.contextmanager
    def running(
        self,
        words: list[str],
        environment: Mapping[str, str | None] | None = None,
        limits: Limits | None = None,
        output: int | Path = subprocess.DEVNULL,
    ) -> Iterator["Running"]:
        """Run ``sphere_nmpc WORDS`` as long as the context lasts.

        Parameters
        ----------
        words : list of str
            The verb and its arguments.
        environment : mapping, optional
            Variables that differ; None takes one away.
        limits : mapping, optional
            Limits of resources.
        output : int or Path, optional
            Where standard output goes; not kept by default.
        """
        command = [sys.executable, "-m", "sphere_sim.cli.child", str(os.getpid()), *words]
        with contextlib.ExitStack() as files:
            told = files.enter_context(self.fresh("stderr").open("w+b"))
            target = files.enter_context(output.open("wb")) if isinstance(output, Path) else output
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=target, stderr=told,
                cwd=self.folder / "work", env=self.environment(environment or {}),
                start_new_session=True, preexec_fn=_limiting(limits or {}),
            )
            try:
                yield Running(process, Path(told.name))
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def run(
        self,
        words: list[str],
        environment: Mapping[str, str | None] | None = None,
        limits: Limits | None = None,
        output: int | Path = subprocess.DEVNULL,
    ) -> Ended:
        """Run a command to its end; parameters as in `running`."""
        with self.running(words, environment, limits, output) as running:
            return running.end()


class Running:
    """A command that runs.

    Parameters
    ----------
    process : Popen
        Leads a session of its own.
    told : Path
        Where its standard error goes.
    """

    def __init__(self, process: subprocess.Popen[bytes], told: Path) -> None:
        self._process = process
        self._told = told
        self._began = time.monotonic()

    def wait_for(self, condition: Callable[[], bool], timeout: float = TIMEOUT) -> bool:
        """Wait until a condition holds; return whether it came to hold before the end."""
        end = time.monotonic() + timeout
        while not condition():
            if self._process.poll() is not None or time.monotonic() > end:
                return condition()
            time.sleep(0.05)
        return True

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def told(self) -> str:
        """What it has written to standard error so far."""
        return self._told.read_text(encoding="utf-8", errors="replace")

    def interrupt(self) -> None:
        """Press Ctrl-C: the whole session gets the signal."""
        self._began = time.monotonic()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGINT)

    def end(self, timeout: float = TIMEOUT) -> Ended:
        """Wait for the end; a command that takes too long is killed, which its code tells."""
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            code = self._process.wait()
        return Ended(code, self.told, time.monotonic() - self._began)


def _limiting(limits: Limits) -> Callable[[], None] | None:
    if not limits:
        return None

    def limit() -> None:
        for kind, most in limits.items():
            resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))

    return limit
