# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bound-constrained nonlinear least squares over the knots of a first-order hold."""
