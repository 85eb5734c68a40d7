# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Floor with edges and obstacles: map, clearance, certified paths, way to a goal."""
