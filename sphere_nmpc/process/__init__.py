# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Processes: their start and end, the channel between two, the threads of their libraries."""
