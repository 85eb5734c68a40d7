# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Near time-optimal control: reach the goal exactly, at rest, in the least time that is found."""
