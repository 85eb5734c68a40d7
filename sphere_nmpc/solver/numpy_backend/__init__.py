# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solver for machines without a C compiler, on NumPy and CasADi's virtual machine."""
