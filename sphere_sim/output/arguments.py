# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Types of command line arguments whose errors name the expected value."""

import math
from argparse import ArgumentTypeError
from collections.abc import Callable
from urllib.parse import urlsplit

_SCHEMES = ("tcp", "tls", "ws", "wss")
"""Protocols of Dask between machines."""


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


def whole(least: int, most: int = 2**63 - 1) -> Callable[[str], int]:
    """Return a type of integers from `least` to `most`."""

    def convert(text: str) -> int:
        digits = text.removeprefix("-")
        is_short = digits.isascii() and digits.isdigit() and len(digits) < 20
        if is_short and least <= int(text) <= most:
            return int(text)
        raise ArgumentTypeError(f"given {text}, expected a whole number from {least} to {most}")

    return convert


def assignment(text: str) -> tuple[str, str]:
    """Return name and value of a setting."""
    name, equals, value = text.partition("=")
    if not equals:
        raise ArgumentTypeError(f"given {text}, expected NAME=VALUE")
    return name.strip(), value.strip()


def cluster_address(text: str) -> str:
    """Return the address of a Dask scheduler, such as ``tcp://host:8786``; tcp may be left out."""
    address = text if "://" in text else f"tcp://{text}"
    try:
        parts = urlsplit(address)
        is_whole = parts.scheme in _SCHEMES and bool(parts.hostname and parts.port)
    except ValueError:
        is_whole = False
    if is_whole:
        return address
    expected = f"tcp://HOST:PORT, or {', '.join(_SCHEMES[1:])} instead of tcp"
    raise ArgumentTypeError(f"given {text}, expected {expected}")


def _number(text: str, expected: str, fits: Callable[[float], bool]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isfinite(value) and fits(value):
        return value
    raise ArgumentTypeError(f"given {text}, expected {expected}")
