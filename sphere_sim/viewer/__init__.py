# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Browser view of the sphere: scene, plots and controls, of live topics or of a bag."""
