# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios, which are starts and goals of runs: the paper's cases, files, random ones."""
