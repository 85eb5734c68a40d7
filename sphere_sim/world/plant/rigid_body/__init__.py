# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plant of rigid bodies on a floor with friction, simulated by MuJoCo."""
