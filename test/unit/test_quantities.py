# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Dataclass fields that check themselves."""

import math
from dataclasses import dataclass

import pytest

from sphere_nmpc.errors import InvalidParameterError, shown
from sphere_nmpc.quantities import quantity, validate


@dataclass(frozen=True)
class Settings:
    length: float = quantity(1.0, "m", "A length", minimum=0.5, maximum=2.0)
    count: int = quantity(3, "-", "A number of things", minimum=1, maximum=9)
    switch: bool = quantity(False, "-", "A switch", live=True)
    colour: str = quantity("red", "-", "A colour", choices=("red", "green"))
    name: str = quantity("", "-", "Any text")
    place: tuple[float, ...] = quantity((0.0, 0.0), "m", "A place", minimum=-5.0, maximum=5.0)
    free: float = quantity(0.0, "s", "A number without bounds")
    note: str = "not a quantity"

    def __post_init__(self) -> None:
        validate(self)


def test_defaults_and_both_ends_of_a_range_are_accepted() -> None:
    Settings()
    Settings(length=0.5, count=1, place=(-5.0, 5.0))
    Settings(length=2.0, count=9, colour="green", name="anything", switch=True, free=-1e300)


@pytest.mark.parametrize(
    ("name", "bad", "expected"),
    [
        ("length", "1", "a finite number [m]"),
        ("length", math.nan, "a finite number [m]"),
        ("length", 0.49, "0.5 to 2 [m]"),
        ("length", 2.01, "0.5 to 2 [m]"),
        ("length", True, "a finite number [m]"),
        ("count", 2.5, "a whole number"),
        ("switch", 1, "true or false"),
        ("colour", "blue", "red or green"),
        ("name", 7, "a text"),
        ("place", (0.0, 0.0, 0.0), "2 numbers [m]"),
        ("place", (0.0, math.nan), "a finite number [m]"),
        ("place", (0.0, 6.0), "-5 to 5 [m]"),
        ("place", None, "2 numbers [m]"),
        ("place", "ab", "2 numbers [m]"),
        ("free", math.inf, "-inf to inf [s]"),
        ("length", 10**400, "0.5 to 2 [m]"),
    ],
)
def test_wrong_value_is_refused_with_what_was_given_and_expected(
    name: str, bad: object, expected: str
) -> None:
    with pytest.raises(InvalidParameterError) as caught:
        Settings(**{name: bad})
    assert caught.value.name == name and caught.value.given is bad
    assert caught.value.expected == expected
    assert str(caught.value) == f"{name}: given {shown(bad)}, expected {expected}"
