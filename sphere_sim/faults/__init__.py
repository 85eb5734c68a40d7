# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a running system, and what counts as having survived it."""
