# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Calls of code of other packages, which may raise anything and need not return.

What would end the process that calls it, such as SystemExit, becomes an error. A process that is
to end interrupts a call that does not return, as far as the interpreter executes it.
"""

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any, TypeVar

from sphere_nmpc.errors import ForeignCodeError, shown

T = TypeVar("T")


class Interruption(BaseException):
    """Raised in foreign code that keeps a process from ending."""

    def __str__(self) -> str:
        return "the process is to end"


_called: set[int] = set()
"""Identifiers of the threads that are in foreign code."""
_is_ending = _is_interrupted = False


def called(call: Callable[..., T], *arguments: Any) -> T:
    """Return the result of a call of foreign code; what it raises is an `Exception` with a text.

    A KeyboardInterrupt is raised as it is where a signal of the user may have caused it.
    """
    if _is_ending:
        raise ForeignCodeError("not called, as the process is to end")
    thread = threading.get_ident()
    is_outer = thread not in _called
    try:
        _called.add(thread)
        found = call(*arguments)
        if is_outer:
            _called.discard(thread)
    except BaseException as error:
        if is_outer:
            _called.discard(thread)
        raise foreign_error(error)  # noqa: B904 - often the same one
    return found


def foreign_error(error: BaseException) -> Exception:
    """Return what foreign code has raised as an error with a text; see `called`."""
    if isinstance(error, KeyboardInterrupt) and _is_of_user():
        raise error
    try:
        text = str(error)
    except BaseException:  # foreign code as well
        text = "without a text"
    else:
        if isinstance(error, Exception):
            return error
    return ForeignCodeError(f"{type(error).__name__} {shown(text)}")


def _is_of_user() -> bool:
    is_raised = signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, on_signal)
    return is_raised and threading.current_thread() is threading.main_thread()


def on_signal(number: int, frame: FrameType | None) -> None:
    """Handle a signal to a process that ends between two calls: by nothing but `end_calls`."""
    global _is_interrupted
    if _is_ending and not _is_interrupted and threading.get_ident() in _called:
        _is_interrupted = True
        raise Interruption


def is_called() -> bool:
    """Return whether the main thread is in foreign code."""
    return threading.main_thread().ident in _called


def end_calls() -> None:
    """Call no foreign code any more, and interrupt that of the main thread.

    The main thread has to handle SIGINT by `on_signal`.
    """
    global _is_ending
    _is_ending = True
    thread = threading.main_thread().ident
    if thread is not None:
        signal.pthread_kill(thread, signal.SIGINT)


def allow_calls() -> None:
    """Call foreign code, as from the start, also after `end_calls`."""
    global _is_ending, _is_interrupted
    _is_ending = _is_interrupted = False
