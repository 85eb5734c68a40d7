# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What other programs and users bring: code, names of classes, files and folders."""
