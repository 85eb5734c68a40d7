# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Round numbers: lengths of grids that suit a robot of any size, and numbers as text."""

import math


def round_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value > 0."""
    # Rounding of the value itself must not lead to the next smaller one.
    exponent = math.floor(math.log10(value) + 1e-9)
    share = value / 10.0**exponent * (1.0 + 1e-9)
    digit = 5 if share >= 5.0 else 2 if share >= 2.0 else 1
    # From text, so that 0.1 is the nearest number to a tenth.
    return float(f"{digit}e{exponent}")


def grid_cell(radius: float) -> float:
    """Return the spacing of a floor's grid for a sphere of a radius [m]: 0.5 m for 0.3 m."""
    return 0.5 * round_down(10.0 / 3.0 * radius)


def length(value: float) -> str:
    """Return a length [m] as text with three significant digits, in mm below a metre."""
    large = abs(float(f"{value:.3g}")) >= 1.0
    return f"{three_digits(value)} m" if large else f"{three_digits(1e3 * value)} mm"


def three_digits(value: float) -> str:
    """Return a number with three significant digits, without an exponent where it is short."""
    return f"{float(f'{value:.3g}'):g}"
