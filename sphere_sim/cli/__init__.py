# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The command line: one module a verb, dispatched by ``main``."""
