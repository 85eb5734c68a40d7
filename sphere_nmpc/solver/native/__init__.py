# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The solver in C: code generation, compilation, and memory shared with it."""
