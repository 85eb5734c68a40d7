# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Results and errors as commands write them: files, folders, figures, numbers, one-line text."""
