# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The solver beside its peers: the same problem, the same plant, the same run."""
