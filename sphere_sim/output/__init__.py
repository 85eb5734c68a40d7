# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands: types of arguments, and results and errors as they write them."""
