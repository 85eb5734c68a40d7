# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the solver against other solvers in the same closed loops."""
