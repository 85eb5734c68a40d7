# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How a command ends: every exception becomes one line on standard error and an exit code."""

import contextlib
import sys
from collections.abc import Callable, Iterator

from sphere_sim.cli.signals import Signals
from sphere_sim.error_text import in_words

_LEFT = "left_behind"


def guarded(name: str, call: Callable[[], int], signals: Signals, debug: bool = False) -> int:
    """Call a verb and return its exit code, whatever happens in it.

    Parameters
    ----------
    name : str
        What the message begins with.
    call : callable
        Returns an exit code.
    signals : Signals
        Tells whether an exception comes from a signal.
    debug : bool, optional
        Whether to show tracebacks.

    Returns
    -------
    int
        That of the verb; the `exit_code` of a `SphereNmpcError`; 128 and the number of a signal
        that ended it; 1 for everything else.
    """
    try:
        return call()
    except (Exception, KeyboardInterrupt) as error:
        signals.ended = True
        if debug:
            import traceback

            traceback.print_exception(error)
        message, code = in_words(error), int(getattr(error, "exit_code", 1))
        # Libraries make errors of their own out of an interrupt.
        if signals.received or isinstance(error, KeyboardInterrupt):
            code = signals.exit_code
            message = "; ".join(("interrupted", *getattr(error, _LEFT, ())))
        print(f"{name}: {message}", file=sys.stderr)
        return code
    finally:
        signals.ended = True


@contextlib.contextmanager
def if_interrupted(left: Callable[[], str]) -> Iterator[None]:
    """Have `guarded` tell what is left behind when a signal ends what is done in this context.

    Whatever exception ends it: not every library lets a KeyboardInterrupt pass as it is. Of
    contexts within each other the innermost tells.

    Parameters
    ----------
    left : callable
        Returns what is left behind and how to go on, in words.
    """
    try:
        yield
    except BaseException as error:
        if not hasattr(error, _LEFT):
            setattr(error, _LEFT, (left(),))
        raise
