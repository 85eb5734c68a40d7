# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors raised while something is being set up; the control loop itself never raises."""


class SphereNmpcError(Exception):
    """Base of every error this package raises on purpose."""

    exit_code = 1
    """Exit code of a command that ends with the error; 2 where the user gave something wrong."""


class InvalidParameterError(SphereNmpcError, ValueError):
    """A parameter is outside what is physically or numerically sensible.

    Parameters
    ----------
    name : str
        Name of the parameter.
    given : object
        The value that was given.
    expected : str
        What would have been accepted, in words.
    """

    exit_code = 2

    def __init__(self, name: str, given: object, expected: str) -> None:
        super().__init__(f"{name}: given {given!r}, expected {expected}")
        self.name = name
        self.given = given
        self.expected = expected


class InvalidStateError(SphereNmpcError, ValueError):
    """A pose, goal or state vector is not finite, not of the right shape or not a rotation."""

    exit_code = 2


class InvalidInputError(SphereNmpcError, ValueError):
    """Rotor speeds are not finite or their knots are not in order of time."""

    exit_code = 2
