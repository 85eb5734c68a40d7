# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of a running system: catalogue, disturbances, limits and outcomes, without ROS."""
