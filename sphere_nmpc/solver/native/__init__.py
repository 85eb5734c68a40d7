# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solver in C: sources, code generation, the built library and shared memory."""
