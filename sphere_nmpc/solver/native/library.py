# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver, which ``setup.py`` builds when the package is installed."""

import ctypes
import logging
import os
from functools import cache
from pathlib import Path

from sphere_nmpc.solver.native.layout import check_sum

FOLDER = Path(__file__).parent
VARIABLE = "SPHERE_NMPC_SOLVER"
"""Environment variable; with the value ``plain`` the compiled solver is not used."""

_log = logging.getLogger("sphere_nmpc")


@cache
def library() -> ctypes.CDLL | None:
    """Return the compiled solver; None, with one warning a process, where it cannot be used.

    `sphere_nmpc.solver.plain` then takes its place.
    """
    try:
        return _loaded()
    except OSError as cause:
        _log.warning(
            "sphere_nmpc: the compiled solver is not used (%s); a plain one takes its place, with "
            "the same results in about 300 times the time. To cure this, install the "
            "package again with a C compiler and CasADi (in a checkout: make venv)", cause,
        )
        return None


def _loaded() -> ctypes.CDLL:
    if os.environ.get(VARIABLE) == "plain":
        raise OSError(f"{VARIABLE}=plain")
    solver = ctypes.CDLL(str(FOLDER / "solver.so"))
    solver.hold_level.restype = ctypes.c_char_p
    # The same for the instruction set of this processor.
    fitting = FOLDER / f"solver{solver.hold_level().decode()}.so"
    if fitting.exists():
        solver = ctypes.CDLL(str(fitting))
    if ctypes.c_int64.in_dll(solver, "hold_layout").value != check_sum():
        raise OSError(f"{fitting} is of another version of the package")
    address, count, number = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    for name, result, arguments in (
        ("hold_solve", None, [address]),
        ("hold_roll_out", None, [count, number, *[address] * 7]),
        ("hold_expand", None, [address] * 4),
        ("hold_half_motions", None, [count, count, *[number] * 3, *[address] * 7]),
        ("hold_workspace", count, [count]),
        ("hold_meet", count, [*[count] * 4, *[number] * 4, *[address] * 10]),
    ):
        function = getattr(solver, name)
        function.argtypes, function.restype = arguments, result
    return solver
