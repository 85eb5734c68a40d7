# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nonlinear model predictive control of a sphere rolled by two internal rotors."""

__version__ = "0.1.0"
