# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Reporting: conditions in one vocabulary, the log of faults, and newest values of a stream."""
