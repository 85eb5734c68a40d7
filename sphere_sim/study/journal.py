# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Journal of a study: one line for each run, written as soon as the run is made.

The first line of ``journal.jsonl`` is the fingerprint of the study. After any interruption the
same command continues from the runs in the journal. Damaged lines are skipped and stay.
"""

import contextlib
import fcntl
import io
import json
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from sphere_sim.output.result_folder import ResultFolderError
from sphere_sim.study.errors import NotWrittenError
from sphere_sim.study.fingerprint import differences
from sphere_sim.study.record import RunRecord

NAME = "journal.jsonl"
_RESULTS = ("runs.csv", "inputs.npz", "summary.json")
_LONGEST_LINE = 2**28
"""Longest line that is read [bytes]; a run of a day has fewer. After a power failure a file may
end in any number of zeros."""
_LISTED = 5
"""Largest number of damaged lines whose numbers a warning lists."""

_log = logging.getLogger("sphere_nmpc")


class Journal:
    """Runs recorded in a folder; a context manager that locks the folder for other studies.

    Parameters
    ----------
    folder : Path
        Created if it does not exist.
    fingerprint : dict
        Fingerprint of the study.

    Raises
    ------
    ResultFolderError
        If the folder cannot be written, holds another study, or another process writes to it.
    """

    def __init__(self, folder: Path, fingerprint: dict[str, Any]) -> None:
        self._folder = folder
        self._path = folder / NAME
        self.records: dict[int, RunRecord] = {}
        """Runs made so far, by number."""
        self._file = self._open()
        try:
            self._read(fingerprint)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "Journal":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with contextlib.suppress(OSError):  # each run was synchronised when it was written
            self._file.close()

    def append(self, index: int, record: RunRecord) -> None:
        """Record run `index`."""
        self._write(record.as_json(index))
        self.records[index] = record

    def _open(self) -> io.FileIO:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if not self._path.exists():
                self._refuse_other_results()
            # On a full disk a buffer would be written again when it is closed, and fail again.
            file = self._path.open("ab", buffering=0)
        except OSError as error:
            reason = f"cannot be written: {(error.strerror or str(error)).lower()}"
            raise ResultFolderError(self._folder, reason) from None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            raise ResultFolderError(
                self._folder, "another study is writing here; choose another folder"
            ) from None
        return file

    def _refuse_other_results(self) -> None:
        for name in _RESULTS:
            if (self._folder / name).exists():
                raise ResultFolderError(
                    self._folder, f"holds {name} of another origin; choose another folder"
                )

    def _read(self, fingerprint: dict[str, Any]) -> None:
        end, damaged = 0, []
        with self._path.open("rb") as file:
            for number, line in enumerate(_whole_lines(file), start=1):
                if number == 1:
                    self._compare(line, fingerprint)
                elif not self._add(line, fingerprint["runs"]):
                    damaged.append(number)
                end += len(line)
        # A last line without an end was being written when the study was stopped.
        self._file.truncate(end)
        if end == 0:
            self._write(json.dumps(fingerprint))
        if damaged:
            listed = ", ".join(map(str, damaged[:_LISTED]))
            more = "" if len(damaged) <= _LISTED else f" and {len(damaged) - _LISTED} more"
            _log.warning(
                "sphere_nmpc study: %s: skipped what is no run of this study (line %s%s); "
                "missing runs are made again", self._path, listed, more,
            )

    def _compare(self, line: bytes, fingerprint: dict[str, Any]) -> None:
        try:
            recorded = json.loads(line)
        except (ValueError, RecursionError):
            recorded = None
        if not isinstance(recorded, dict):
            raise ResultFolderError(
                self._folder, f"{NAME}, line 1: not the settings of a study; choose another folder"
            )
        found = list(differences(recorded, fingerprint))
        if found:
            more = "" if len(found) <= 3 else f" and {len(found) - 3} more"
            raise ResultFolderError(
                self._folder,
                f"holds another study ({'; '.join(found[:3])}{more}); choose another folder",
            )

    def _add(self, line: bytes, runs: int) -> bool:
        """Add the run of a line; return False where the line holds none of this study."""
        try:
            index, record = RunRecord.from_json(line.decode())
        except ValueError:
            return False
        if not 0 <= index < runs:
            return False
        self.records[index] = record
        return True

    def _write(self, line: str) -> None:
        rest = memoryview(line.encode() + b"\n")
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            raise NotWrittenError(self._path, error) from None


def _whole_lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield all lines but a last one without an end; too long ones in pieces."""
    while line := file.readline(_LONGEST_LINE):
        if line.endswith(b"\n") or len(line) == _LONGEST_LINE:
            yield line
