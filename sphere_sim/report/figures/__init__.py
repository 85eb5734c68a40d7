# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of recorded runs, in the form of the paper and beyond."""
