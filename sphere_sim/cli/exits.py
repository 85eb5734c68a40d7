# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How a command ends: every exception becomes one line on standard error and an exit code."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec

from sphere_sim.cli.signals import Signals

# Extra of setup.py -> import names it brings, message packages apart.
EXTRAS = {
    "ros": ("rclpy", "ament_index_python", "builtin_interfaces", "rcl_interfaces", "std_srvs"),
    "record": ("rosbags", "mcap", "mcap_ros2", "ruamel", "zstandard"),
    "sim": ("rich", "matplotlib"),
    "study": ("dask", "distributed"),
    "rigid": ("mujoco",),
    "viewer": ("viser",),
    "report": ("pyarrow",),
}

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


def in_words(error: BaseException) -> str:
    """Return what an exception means to a user."""
    missing = _missing_package(error)
    if missing:
        return _advice(missing)
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename is not None else ""
        return f"{where}{error.strerror}"
    if isinstance(error, MemoryError):
        return "there is not enough memory"
    if hasattr(error, "exit_code"):
        return str(error)
    told = " ".join(str(error).split())
    return f"unexpected {type(error).__name__}: {told} (--debug shows where)"


def _missing_package(error: BaseException) -> str:
    """Return the package that is not installed; empty for any other fault."""
    if not isinstance(error, ModuleNotFoundError):
        return ""
    package = (error.name or "").partition(".")[0]
    try:
        return "" if find_spec(package) else package
    except ValueError:  # hidden from the import system
        return package


def _advice(missing: str) -> str:
    if missing.endswith("_msgs"):
        missing_from = "ros"
    else:
        missing_from = next((e for e, names in EXTRAS.items() if missing in names), "all")
    return f"'{missing}' is not installed; it comes with pip install 'sphere_nmpc[{missing_from}]'"
