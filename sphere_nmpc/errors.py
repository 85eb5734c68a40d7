# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors raised outside the control loop, and the text of others as errors and logs show it.

Inside the control loop nothing raises.
"""

import re

LONGEST = 100
"""Characters of a foreign text that are shown."""
LONGEST_LINE = 600
"""Characters of a line that may contain several."""
_SCALAR = re.compile(r"\bnp\.(?:(True|False)_|[a-z]+\d*_?\(([^()]*)\))")
"""Scalar of NumPy, of which `repr` also says its type."""


class Description(str):
    """Words that stand for what another program gave, such as its size or the lack of it."""


def shown(value: object) -> str:
    """Return a value of another program as `repr`, cut to `LONGEST` characters.

    `repr` escapes line breaks and the control sequences of terminals, so that a foreign text can
    neither forge a line of a log nor act on a terminal. Numbers of NumPy are written as others
    are, arrays in one line, and a `Description` as it is.
    """
    if isinstance(value, Description):
        return cut(printable_line(value), LONGEST)
    if isinstance(value, str | bytes | bytearray | list | tuple):
        value = value[: LONGEST + 1]  # the rest would only be escaped to be cut off
    text = repr(value)
    if not isinstance(value, str | bytes | bytearray):
        # Arrays have a line for each row.
        text = _SCALAR.sub(r"\1\2", " ".join(text.split()))
    return cut(text, LONGEST)


def printable_line(line: str) -> str:
    """Return a line with what cannot be printed escaped, cut to `LONGEST_LINE` characters.

    For the place where lines are written, whatever they were made of.
    """
    line = cut(line, LONGEST_LINE)
    return line if line.isprintable() else cut(repr(line)[1:-1], LONGEST_LINE)


def cut(text: str, longest: int) -> str:
    """Return a text, or its beginning with ``...`` where it has more characters than `longest`."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


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
