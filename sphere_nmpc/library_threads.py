# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One thread each for the libraries of linear algebra that numpy loads."""

import os

ONE_EACH = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment variables; read once, when numpy is first loaded."""


def limit_library_threads() -> None:
    """Set the variables that the user has not set.

    Matrices of five rows gain nothing from threads, and threads that wait for work take the
    processor from the control loop and from other processes.
    """
    for name, count in ONE_EACH.items():
        os.environ.setdefault(name, count)
