# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver."""

import ctypes

from sphere_nmpc.solver.native.library import library


def compiled() -> ctypes.CDLL:
    """Return the compiled solver, which tests require."""
    found = library()
    assert found is not None, "the solver is not built: make venv"
    return found
