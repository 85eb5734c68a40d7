# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Limit of one thread for each linear algebra library that NumPy loads."""

import os

ONE_EACH = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment variables; read once, when numpy is first loaded."""


def limit_library_threads() -> None:
    """Set the variables that the user has not set.

    Matrices of five rows gain nothing from threads, and idle threads that spin take processor time
    from the control loop and from other processes.
    """
    for name, count in ONE_EACH.items():
        os.environ.setdefault(name, count)
