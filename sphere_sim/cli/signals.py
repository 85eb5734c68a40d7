# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM as KeyboardInterrupt, wherever they find the process."""

import os
import signal
import sys
from types import FrameType

STOPPING = (signal.SIGINT, signal.SIGTERM)
_EXIT_CODE = 128
"""What a shell adds to the number of the signal that ended a program."""
_AGAIN = 0.02
"""Delay before a signal is repeated [s]."""
_LOSING = "casadi."
"""Modules in which an exception of a signal handler is lost."""
_DEPTH = 3
"""How many frames are looked at for such a module."""


class Signals:
    """The handlers of a command's process.

    While modules are loaded a signal ends the process at once: nothing has been started yet, and
    a KeyboardInterrupt in the middle of an import leaves as whatever the module makes of it.
    After that it raises KeyboardInterrupt, where that is not lost: an exception in a finaliser
    cannot be raised, and CasADi's bindings replace one that comes while they convert arguments.
    There the signal is repeated a little later. A signal that is ignored from the start, as in
    the background of a shell script, stays ignored.
    """

    def __init__(self) -> None:
        self.received = 0
        """Number of the signal that has come; 0 before."""
        self.ended = False
        """Whether the work is over, so that there is nothing left to interrupt."""

    def exit_at_once(self) -> None:
        """End the process on a signal from now on: nothing is begun yet, or all is done."""
        for number in STOPPING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._exit)

    def interrupt(self) -> None:
        """Raise KeyboardInterrupt on a signal from now on."""
        sys.unraisablehook = self._repeat_if_swallowed
        # A timer of the system: starting a thread within a signal handler could block for ever.
        signal.signal(signal.SIGALRM, lambda _, frame: self._raise(self.received, frame))
        for number in STOPPING:
            if signal.getsignal(number) == self._exit:
                signal.signal(number, self._raise)

    @property
    def exit_code(self) -> int:
        """What a shell reports of a program that the signal ended."""
        return _EXIT_CODE + (self.received or signal.SIGINT)

    def _exit(self, number: int, frame: FrameType | None) -> None:
        os._exit(_EXIT_CODE + number)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        if self.ended:
            return
        self.received = number
        if _loses_exceptions(frame):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        else:
            raise KeyboardInterrupt

    def _repeat_if_swallowed(self, unraisable: "sys.UnraisableHookArgs") -> None:
        if isinstance(unraisable.exc_value, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        elif not self.received:
            sys.__unraisablehook__(unraisable)


def _loses_exceptions(frame: FrameType | None) -> bool:
    for _ in range(_DEPTH):
        if frame is None:
            return False
        if str(frame.f_globals.get("__name__", "")).startswith(_LOSING):
            return True
        frame = frame.f_back
    return False
