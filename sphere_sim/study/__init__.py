# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Many closed loops on all cores: what is run, where it is kept and what it comes down to."""
