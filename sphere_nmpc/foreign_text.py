# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Text and values from other programs, made fit for a log, a terminal and a status."""

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
