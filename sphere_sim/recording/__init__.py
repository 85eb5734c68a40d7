# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags: written so that they survive a crash, and read back as arrays; neither needs ROS."""
