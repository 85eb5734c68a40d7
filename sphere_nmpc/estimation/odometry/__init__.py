# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pose of the sphere from inside: by an IMU in the shell and the encoders of the rotors."""

from sphere_nmpc.estimation.odometry.odometry import Odometry

__all__ = ["Odometry"]
