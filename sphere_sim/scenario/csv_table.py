# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables that a user gives: CSV in UTF-8 with a header, read row by row in bounded memory."""

import csv
import io
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_file import InvalidFileError, open_file
from sphere_nmpc.foreign_text import printable_line, shown
from sphere_nmpc.quantity import counted

LARGEST_FILE = 2**28
"""Largest file that is read [bytes]."""
MOST_FIELDS = 12_000_000
"""Fields of all rows that are read: a million rows of the columns that a scenario has to have,
which take 1.5 GB of memory."""

Row = tuple[int, dict[str, str]]
"""Line, counted from 1, and texts by column."""


class CsvFileError(SphereNmpcError, ValueError):
    """A table cannot be read or is invalid; lines are counted from 1."""

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
        self.line = line
        self.column = column
        self.given = given
        self.expected = expected


def read_rows(
    path: Path, needed: Callable[[Sequence[str]], Sequence[str]], what: str, plain: bool = False
) -> Iterator[Row]:
    """Yield all rows of a file but for blank ones.

    Parameters
    ----------
    path : Path
        The file.
    needed : callable
        Returns the columns that a file has to have that has the given ones.
    what : str
        What a row is; there has to be at least one.
    plain : bool
        Whether the header may be left out where there are no other columns.

    Raises
    ------
    CsvFileError
        What is wrong, and where.
    """
    try:
        # utf-8-sig: some spreadsheets write a byte order mark before the first name.
        with io.TextIOWrapper(
            open_file(path, LARGEST_FILE), encoding="utf-8-sig", newline=""
        ) as file:
            yield from _rows(path, file, needed, what, plain)
    except CsvFileError:
        raise
    except UnicodeDecodeError as error:
        raise CsvFileError(
            path, f"the byte 0x{error.object[error.start]:02x}", "text encoded in UTF-8",
            _line_of_bad_byte(path),
        ) from None
    except InvalidFileError as error:
        raise CsvFileError(path, str(error.given), error.expected) from None
    except (OSError, ValueError) as error:  # the latter for a name with a NUL
        reason = getattr(error, "strerror", None) or str(error)
        raise CsvFileError(path, reason.lower(), "a CSV file that can be read") from None


def _rows(
    path: Path, file: TextIO, needed: Callable[[Sequence[str]], Sequence[str]], what: str,
    plain: bool,
) -> Iterator[Row]:
    reader = csv.reader(file, strict=True)
    header: Sequence[str] | None = None
    count = 0
    while True:
        line = reader.line_num + 1
        try:
            fields = next(reader, None)
        except csv.Error as error:
            raise CsvFileError(path, str(error), "a row of CSV", line) from None
        if fields is None:
            break
        if not any(text.strip() for text in fields):
            continue
        if header is None and plain and _value(fields[0]) is not None:
            header = needed(())
        if header is None:
            header = [text.strip() for text in fields]
            _check_header(path, line, header, needed(header))
            continue
        if len(fields) != len(header):
            raise CsvFileError(
                path, counted(len(fields), "field"), f"{len(header)}, as in the header", line
            )
        count += 1
        if count * len(header) > MOST_FIELDS:
            raise CsvFileError(
                path, f"more than {MOST_FIELDS} fields",
                f"at most {MOST_FIELDS // len(header)} rows of {len(header)} columns", line,
            )
        yield line, dict(zip(header, fields, strict=True))
    if header is None:
        raise CsvFileError(path, "an empty file", f"a header {','.join(needed(()))}")
    if not count:
        raise CsvFileError(path, "a header alone", f"at least one {what}")


def _check_header(path: Path, line: int, names: Sequence[str], needed: Sequence[str]) -> None:
    for name in needed:
        if name not in names:
            raise CsvFileError(
                path, f"the columns {shown(','.join(names))}", "a column of this name", line, name
            )
    for name, times in Counter(names).items():
        if times > 1:
            raise CsvFileError(path, "a name twice", "each column once", line, name)


def number(
    path: Path, line: int, name: str, text: str, most: float = math.inf, unit: str = ""
) -> float:
    """Return a finite number, of at most this magnitude."""
    value = _value(text)
    if value is None:
        raise CsvFileError(path, shown(text), "a finite number", line, name)
    if abs(value) > most:
        raise CsvFileError(path, shown(text), f"-{most:g} to {most:g} [{unit}]", line, name)
    return value


def _value(text: str) -> float | None:
    """Return the finite number that a text is; None for any other text."""
    try:
        # Python accepts 1_000, which other readers of CSV do not.
        value = math.nan if "_" in text else float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _line_of_bad_byte(path: Path) -> int | None:
    try:
        path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        return error.object[: error.start].count(b"\n") + 1
    return None
