# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The sphere as a mechanism of rigid bodies on a floor with friction, simulated by MuJoCo."""
