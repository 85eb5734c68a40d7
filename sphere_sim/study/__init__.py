# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Studies: many closed loops on all cores, their records, tables and figures."""
