# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Process beside the control loop that searches and learns, and the contract with it."""
