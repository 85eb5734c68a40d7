# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How a command ends: signals raise at any time, exceptions are one line and an exit code."""

import contextlib
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from types import FrameType

from sphere_nmpc.process.child import END_SIGNALS
from sphere_sim.output.error_text import in_words

_EXIT_CODE = 128
"""Offset of a shell's exit code from the number of the signal that ended a program."""
_AGAIN = 0.02
"""Delay before a signal is repeated [s]."""
_LOSSY = re.compile(r"casadi\.|\w+\.(msg|srv|action)\._")
"""Beginning of the names of modules in which an exception of a signal handler is lost."""
_DEPTH = 3
"""Number of frames that are searched for such a module."""
_REMAINS = "remains_after_interrupt"


class Signals:
    """The handlers of a command's process.

    While modules are loaded a signal ends the process immediately: nothing has been started yet,
    and a module may replace a KeyboardInterrupt during its import by another exception. After that
    a signal raises KeyboardInterrupt. Where that would be lost, the signal is repeated a little
    later: in a finaliser, which cannot raise, in CasADi's bindings, which replace an exception
    while they convert arguments, and in the constructors of messages, as those who deserialise
    them make it one about the message. A signal that is ignored from the start, as in the
    background of a shell script or by ``nohup``, stays ignored.
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
        if _LOSSY.match(str(frame.f_globals.get("__name__", ""))):
            return True
        frame = frame.f_back
    return False


def guarded(name: str, call: Callable[[], int], signals: Signals, debug: bool = False) -> int:
    """Call a verb and return its exit code; exceptions are printed behind its name.

    The code is that of the verb; the `exit_code` of a `SphereNmpcError`; 128 and the number of a
    signal that ended it; 1 for everything else.
    """
    try:
        return call()
    except (Exception, KeyboardInterrupt) as error:
        signals.ended = True
        if debug:
            import traceback

            traceback.print_exception(error)
        message, code = in_words(error), int(getattr(error, "exit_code", 1))
        # Libraries convert a KeyboardInterrupt into exceptions of their own.
        if signals.received or isinstance(error, KeyboardInterrupt):
            code = signals.exit_code
            message = "; ".join(("interrupted", *getattr(error, _REMAINS, ())))
        print(f"{name}: {message}", file=sys.stderr)
        return code
    finally:
        signals.ended = True


@contextlib.contextmanager
def if_interrupted(remains: Callable[[], str]) -> Iterator[None]:
    """Add to the message of `guarded` what remains when a signal ends this context.

    It is added to whatever exception ends the context, as some libraries replace a
    KeyboardInterrupt by another exception. Of nested contexts the innermost one counts.
    """
    try:
        yield
    except BaseException as error:
        if not hasattr(error, _REMAINS):
            setattr(error, _REMAINS, (remains(),))
        raise
