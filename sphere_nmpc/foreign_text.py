# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Text and values from other programs, made fit for a log, a terminal and a status."""

LONGEST = 100
"""Characters of a foreign text that are shown."""


def shown(value: object) -> str:
    """Return a value of another program as `repr`, cut to `LONGEST` characters.

    `repr` escapes line breaks and the control sequences of terminals, so that a foreign text can
    neither forge a line of a log nor act on a terminal.
    """
    if isinstance(value, str | bytes | bytearray):
        value = value[: LONGEST + 1]  # the rest would only be escaped to be cut off
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
