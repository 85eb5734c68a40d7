# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes of simulator, recorder and viewer, and sessions of several nodes."""
