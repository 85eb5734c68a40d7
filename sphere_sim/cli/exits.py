# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Exceptions of a command as one line on standard error and an exit code."""

import contextlib
import sys
from collections.abc import Callable, Iterator

from sphere_sim.cli.signals import Signals
from sphere_sim.output.error_text import in_words

_REMAINS = "remains_after_interrupt"


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
