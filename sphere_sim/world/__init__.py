# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of the robot: plants, drives, sensors and clock."""
