# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Objective and shooting in their plainest form, with which tests compare the solvers."""
