# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Text of exceptions for users, in one line."""

import logging
from collections.abc import Callable
from importlib.util import find_spec

from sphere_nmpc.errors import printable_line

# Extra of setup.py -> import names it brings, message packages apart.
EXTRAS = {
    "ros": ("rclpy", "ament_index_python", "builtin_interfaces", "rcl_interfaces", "std_srvs"),
    "record": ("rosbags", "mcap", "mcap_ros2", "ruamel", "zstandard", "lz4"),
    "sim": ("rich", "matplotlib", "scipy"),
    "study": ("dask", "distributed"),
    "rigid": ("mujoco",),
    "viewer": ("viser",),
    "benchmark": ("casadi",),
}

_log = logging.getLogger("sphere_nmpc")


def in_words(error: BaseException) -> str:
    """Return what an exception means to a user."""
    missing = _missing_package(error)
    if missing:
        return how_to_install(missing)
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename is not None else ""
        return f"{where}{error.strerror}"
    if isinstance(error, MemoryError):
        return "there is not enough memory"
    if hasattr(error, "exit_code"):
        return str(error)
    message = printable_line(" ".join(str(error).split()))
    return f"unexpected {type(error).__name__}: {message} (--debug shows where)"


def _missing_package(error: BaseException) -> str:
    """Return the package that is not installed; empty for any other fault."""
    if not isinstance(error, ModuleNotFoundError):
        return ""
    package = (error.name or "").partition(".")[0]
    return "" if find_spec(package) else package


def how_to_install(missing: str) -> str:
    """Return what installs a Python package that is missing, given its import name."""
    if missing.endswith("_msgs"):
        extra = "ros"
    else:
        extra = next((e for e, names in EXTRAS.items() if missing in names), "")
    source = f"'sphere_nmpc[{extra}]'" if extra else "sphere_nmpc"
    return f"'{missing}' is not installed; it comes with pip install {source}"


def draw_or_warn(verb: str, what: str, draw: Callable[[], object]) -> bool:
    """Draw and write a figure that is only added to results; return whether that was possible.

    Any error is a warning of one line, which names the verb that draws and the file.
    """
    try:
        draw()
    except Exception as error:  # any error of the plotting library; the numbers are written
        _log.warning("sphere_nmpc %s: %s not drawn: %s", verb, what, in_words(error))
        return False
    return True
