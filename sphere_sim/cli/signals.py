# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Handlers that turn the signals that ask to end into KeyboardInterrupt at any time."""

import os
import signal
import sys
from types import FrameType

from sphere_nmpc.end_signals import END_SIGNALS

_EXIT_CODE = 128
"""Offset of a shell's exit code from the number of the signal that ended a program."""
_AGAIN = 0.02
"""Delay before a signal is repeated [s]."""
_LOSSY = "casadi."
"""Prefix of modules in which an exception of a signal handler is lost."""
_DEPTH = 3
"""Number of frames that are searched for such a module."""


class Signals:
    """The handlers of a command's process.

    While modules are loaded a signal ends the process immediately: nothing has been started yet,
    and a module may replace a KeyboardInterrupt during its import by another exception. After that
    a signal raises KeyboardInterrupt. Where that would be lost, the signal is repeated a little
    later: in a finaliser, which cannot raise, and in CasADi's bindings, which replace an exception
    while they convert arguments. A signal that is ignored from the start, as in the background of
    a shell script or by ``nohup``, stays ignored.
    """

    def __init__(self) -> None:
        self.received = 0
        """Number of the signal that was received; 0 before."""
        self.ended = False
        """Whether the verb has ended, after which signals are ignored."""

    def exit_immediately(self) -> None:
        """End the process on a signal from now on: before the work has begun, or after its end."""
        for number in END_SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._exit)

    def interrupt(self) -> None:
        """Raise KeyboardInterrupt on a signal from now on."""
        sys.unraisablehook = self._repeat_if_swallowed
        # A timer of the system: starting a thread in a signal handler could block forever.
        signal.signal(signal.SIGALRM, lambda _, frame: self._raise(self.received, frame))
        for number in END_SIGNALS:
            if signal.getsignal(number) == self._exit:
                signal.signal(number, self._raise)

    @property
    def exit_code(self) -> int:
        """The exit code that a shell reports for a program that the signal ended."""
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
        if str(frame.f_globals.get("__name__", "")).startswith(_LOSSY):
            return True
        frame = frame.f_back
    return False
