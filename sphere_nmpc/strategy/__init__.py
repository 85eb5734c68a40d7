# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is solved at each sample: one module per strategy behind one contract."""
