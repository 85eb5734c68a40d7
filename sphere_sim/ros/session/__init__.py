# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sessions of several nodes: child processes, a ROS domain of their own, goals."""
