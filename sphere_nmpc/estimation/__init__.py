# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimation of the state and of the plant's parameters from poses and the rotor speeds sent."""
