# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control loop around a strategy: what is known, what is sent, what happens on bad days."""
