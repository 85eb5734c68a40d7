# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The solver in its readable form, which the compiled one is tested against."""
