# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Types of command line arguments whose errors name the expected value."""

import math
from argparse import ArgumentTypeError
from collections.abc import Callable


def finite(text: str) -> float:
    """Return a number that is neither infinite nor nan."""
    return _number(text, "a finite number", lambda value: True)


def positive(text: str) -> float:
    """Return a finite number above 0."""
    return _number(text, "a number above 0", lambda value: value > 0.0)


def not_negative(text: str) -> float:
    """Return a finite number from 0 on."""
    return _number(text, "a number from 0 on", lambda value: value >= 0.0)


def number(least: float, most: float) -> Callable[[str], float]:
    """Return a type of numbers from `least` to `most`."""
    expected = f"a number from {least:g} to {most:g}"
    return lambda text: _number(text, expected, lambda value: least <= value <= most)


def whole(least: int, most: int | None = None) -> Callable[[str], int]:
    """Return a type of integers from `least` on, up to `most` if that is given."""

    def convert(text: str) -> int:
        digits = text.removeprefix("-")
        within = digits.isascii() and digits.isdigit() and len(digits) < 20 and least <= int(text)
        if within and (most is None or int(text) <= most):
            return int(text)
        end = "on" if most is None else f"to {most}"
        raise ArgumentTypeError(f"given {text}, expected a whole number from {least} {end}")

    return convert


def _number(text: str, expected: str, fits: Callable[[float], bool]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isfinite(value) and fits(value):
        return value
    raise ArgumentTypeError(f"given {text}, expected {expected}")
