# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors raised outside the control loop, which itself never raises."""

from sphere_nmpc.foreign_text import shown


class SphereNmpcError(Exception):
    """Base class of the errors of this package."""

    exit_code = 1
    """Exit code of a command that ends with the error; 2 where the user gave something wrong."""


class InvalidValueError(SphereNmpcError, ValueError):
    """Value that is not accepted: its name, what was given, and what would be accepted."""

    exit_code = 2

    def __init__(self, name: str, given: object, expected: str) -> None:
        super().__init__(f"{name}: given {shown(given)}, expected {expected}")
        self.name = name
        self.given = given
        self.expected = expected


class InvalidParameterError(InvalidValueError):
    """Parameter outside its valid range."""


class InvalidStateError(InvalidValueError):
    """Pose, goal or state vector that is not finite, has a wrong shape or no unit quaternion."""


class InvalidInputError(InvalidValueError):
    """Rotor speeds that are not finite, or knots whose times do not increase."""


class ForeignCodeError(SphereNmpcError):
    """Code of another package has raised what is no error, such as SystemExit, or has no text."""


class EndingError(SphereNmpcError):
    """Error of a node's own work after which the node cannot go on: it ends, with the reason."""


def reason_of(error: Exception) -> str:
    """Return the message of an error; that of another package has its type and is foreign."""
    if isinstance(error, SphereNmpcError):
        return str(error)
    return f"{type(error).__name__} {shown(str(error))}"
