# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sizes for which CasADi functions are built: few, as a build takes hundredths of a second."""


def rounded_size(size: int) -> int:
    """Return the least of 1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, ... that is enough."""
    spacing = 1 << max(0, size.bit_length() - 3)
    return -(-size // spacing) * spacing
