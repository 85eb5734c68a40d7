# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control loop around strategy and estimator, its schedule, and what monitors it."""
