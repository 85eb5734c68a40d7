# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies: what is solved at each sample, behind one contract."""
