# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The memory of a study: a line a run, written as soon as it is known.

``journal.jsonl`` starts with the fingerprint of the study. Whatever stops a study, the runs that
were made are in there, and the same command goes on from them.
"""

import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from sphere_sim.study.errors import StudyFolderError
from sphere_sim.study.fingerprint import differences
from sphere_sim.study.record import RunRecord

NAME = "journal.jsonl"
_RESULTS = ("runs.csv", "inputs.npz", "summary.json")


class Journal:
    """Runs recorded in a folder; a context manager that keeps other studies out of it.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    fingerprint : dict
        Of the study that wants to write here.

    Raises
    ------
    StudyFolderError
        If the folder cannot be written, holds another study, or another process writes to it.
    """

    def __init__(self, folder: Path, fingerprint: dict[str, Any]) -> None:
        self._folder = folder
        self._path = folder / NAME
        self.records: dict[int, RunRecord] = {}
        """Runs made so far, by number."""
        self._file = self._open()
        try:
            self._recall(fingerprint)
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
        self._file.close()

    def append(self, index: int, record: RunRecord) -> None:
        """Remember run `index`."""
        self._write(record.as_json(index))
        self.records[index] = record

    def _open(self) -> IO[bytes]:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if not self._path.exists():
                self._refuse_foreign_results()
            file = self._path.open("a+b")
        except OSError as error:
            reason = f"cannot be written: {(error.strerror or str(error)).lower()}"
            raise StudyFolderError(self._folder, reason) from None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            raise StudyFolderError(
                self._folder, "another study is writing here; choose another folder"
            ) from None
        return file

    def _refuse_foreign_results(self) -> None:
        for name in _RESULTS:
            if (self._folder / name).exists():
                raise StudyFolderError(
                    self._folder, f"holds {name} of something else; choose another folder"
                )

    def _recall(self, fingerprint: dict[str, Any]) -> None:
        self._file.seek(0)
        end = 0
        lines = self._file.readlines()
        for number, line in enumerate(lines, start=1):
            # A line that was being written when the power went is no run that was made.
            if not line.endswith(b"\n") and number == len(lines):
                break
            try:
                self._take(number, line.decode(), fingerprint)
            except ValueError as error:
                reason = f"{NAME}, line {number}: {error}; choose another folder"
                raise StudyFolderError(self._folder, reason) from None
            end += len(line)
        self._file.truncate(end)
        if end == 0:
            self._write(json.dumps(fingerprint))

    def _take(self, number: int, line: str, fingerprint: dict[str, Any]) -> None:
        if number > 1:
            index, record = RunRecord.from_json(line)
            self.records[index] = record
            return
        found = list(differences(json.loads(line), fingerprint))
        if found:
            more = "" if len(found) <= 3 else f" and {len(found) - 3} more"
            raise StudyFolderError(
                self._folder,
                f"holds another study ({'; '.join(found[:3])}{more}); choose another folder",
            )

    def _write(self, line: str) -> None:
        try:
            self._file.write(line.encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise StudyFolderError(self._folder, f"{NAME}: {error.strerror}") from None
