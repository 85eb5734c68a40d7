# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Choice between the compiled solver and the one on NumPy."""

import logging
from functools import cache

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.solver.native.compiler import CompilerError
from sphere_nmpc.solver.native.memory import library

BACKENDS = ("auto", "compiled", "numpy")

_log = logging.getLogger("sphere_nmpc")


def resolve_backend(backend: str) -> str:
    """Return "compiled" or "numpy", whichever `backend` means on this machine.

    Parameters
    ----------
    backend : str
        "compiled"; "numpy"; or "auto": compiled where that is possible, otherwise NumPy, with one
        warning a process.

    Raises
    ------
    CompilerError
        If "compiled" is required and the compiled solver can neither be loaded nor built.
    InvalidParameterError
        If the name is not one of `BACKENDS`.
    """
    if backend not in BACKENDS:
        raise InvalidParameterError("backend", backend, "one of " + ", ".join(BACKENDS))
    if backend == "numpy":
        return backend
    problem = _compiler_problem()
    if problem is None:
        return "compiled"
    if backend == "compiled":
        raise problem
    return "numpy"


@cache
def _compiler_problem() -> CompilerError | None:
    """Return why there is no compiled solver, None where there is one; the first call warns."""
    try:
        library()
    except CompilerError as problem:
        _log.warning(
            "sphere_nmpc: %s. The solver runs on CasADi's virtual machine, with the same results "
            "but a solve takes twenty to fifty times as long; to cure this, %s",
            problem.cause, problem.cure,
        )
        return problem
    return None
