# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors of scenario files."""

from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_text import printable_line


class ScenarioFileError(SphereNmpcError, ValueError):
    """A scenario file cannot be read or is invalid.

    Parameters
    ----------
    path : Path
        The file.
    given, expected : str
        What the file has and what is accepted.
    line : int, optional
        Line of the file, counted from 1.
    column : str, optional
        Name of the column.
    """

    exit_code = 2

    def __init__(
        self, path: Path, given: str, expected: str, line: int | None = None, column: str = ""
    ) -> None:
        where = str(path)
        if line is not None:
            where += f", line {line}"
        if column:
            where += f", column {column}"
        super().__init__(printable_line(f"{where}: given {given}, expected {expected}"))
        self.path = path
        self.line = line
        self.column = column
        self.given = given
        self.expected = expected
