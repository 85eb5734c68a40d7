# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recording of bags that survive a crash, and reading of bags as arrays, both without ROS."""
