# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops without ROS, and metrics of their quality."""
