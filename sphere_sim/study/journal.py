# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Journal of a study: one line for each run, written as soon as the run is made.

The first line of ``journal.jsonl`` is the fingerprint of the study: settings, scenarios and code,
which decide the results of its runs. After any interruption the same command continues from the
runs in the journal. Damaged lines are skipped and stay.
"""

import contextlib
import fcntl
import hashlib
import io
import json
import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import sphere_nmpc
import sphere_sim
from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.floor.settings import FloorSettings
from sphere_sim.output.files import ResultFolderError
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import RunRecord
from sphere_sim.study.single_run import floor_of

NAME = "journal.jsonl"
_OF_RUNS = ("evaluation", "scenario", "study", "world")
"""Packages of `sphere_sim` that a run may execute."""
_SOURCES = (".py", ".c", ".h")
_DIGESTS = {
    "scenarios": "other scenarios", "code": "another state of the code",
    "map": "another map",
}
"""What is said of the parts of a fingerprint that are digests where they differ."""
_RESULTS = ("runs.csv", "inputs.npz", "summary.json")
_LISTED = 5
"""Largest number of damaged lines whose numbers a warning lists."""

_log = logging.getLogger("sphere_nmpc")


class NotWrittenError(SphereNmpcError):
    """A file of results cannot be written; its previous content is kept."""

    def __init__(self, path: Path, error: OSError) -> None:
        reason = (error.strerror or str(error)).lower()
        super().__init__(
            f"{path}: cannot be written: {reason}; the same command continues from the runs made"
        )


def fingerprint(conditions: StudyConditions, scenarios: Sequence[Scenario]) -> dict[str, Any]:
    """Return all that decides the results of a study's runs, as JSON content."""
    content = {
        "conditions": asdict(conditions),
        "runs": len(scenarios),
        "scenarios": _digest(_scenario_bytes(scenarios)),
        "code": code_digest(),
    }
    floors = [scenario.floor(conditions.floor) for scenario in scenarios]
    maps = {each: _map_bytes(each, conditions.robot.shell_radius) for each in {*floors}}
    if any(maps.values()):
        content["map"] = _digest(maps[each] for each in floors)
    # Through JSON and back, so that it equals what is read from a file.
    plain: dict[str, Any] = json.loads(json.dumps(content))
    return plain


@cache
def code_digest() -> str:
    """Return a digest of the sources of all packages that a run may execute.

    A version number would not change with each edit of a source.
    """
    core, simulation = (Path(str(tree.__file__)).parent for tree in (sphere_nmpc, sphere_sim))
    folders = {path.name: path for path in core.iterdir() if path.name != "ros"}
    folders |= {name: simulation / name for name in _OF_RUNS}
    parts = [
        part
        for name, folder in sorted(folders.items())
        for path in sorted((folder, *folder.rglob("*")))
        if path.suffix in _SOURCES
        for part in (f"{name}/{path.relative_to(folder)}".encode(), path.read_bytes())
    ]
    return _digest(parts)


def _scenario_bytes(scenarios: Sequence[Scenario]) -> Iterator[bytes]:
    for scenario in scenarios:
        yield scenario.start.tobytes() + scenario.goal.tobytes()
        yield b"" if scenario.follows is None else scenario.follows.places.tobytes()
        about = [scenario.seed, scenario.extra, scenario.given, scenario.optional]
        yield json.dumps(about).encode()


def _map_bytes(settings: FloorSettings, radius: float) -> bytes:
    """Return a digest of what is occupied of a floor; empty where nothing is."""
    floor, _ = floor_of(settings, radius)
    if floor.is_empty:
        return b""
    about = json.dumps([floor.grid.resolution, floor.grid.origin, floor.grid.occupied.shape])
    return _digest([about.encode(), np.packbits(floor.grid.occupied).tobytes()]).encode()


def _digest(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


class Journal:
    """Runs recorded in a folder, created if needed; a context manager that locks it for others.

    `ResultFolderError` is raised if it cannot be written, holds another study, or is locked.
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

    def __exit__(self, *exception: object) -> None:
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
            for number, line in enumerate(file, start=1):
                if not line.endswith(b"\n"):
                    break  # it was being written when the study was stopped
                if number == 1:
                    self._compare(line, fingerprint)
                elif not self._add(line, fingerprint["runs"]):
                    damaged.append(number)
                end += len(line)
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
        found = list(_differences(recorded, fingerprint))
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


def _differences(recorded: Any, given: Any, name: str = "") -> Iterator[str]:
    """Yield a description of each difference between two fingerprints."""
    if isinstance(recorded, dict) and isinstance(given, dict):
        for key in sorted(recorded.keys() | given.keys()):
            place = f"{name}.{key}".removeprefix(".conditions").removeprefix(".")
            yield from _differences(recorded.get(key), given.get(key), place)
    elif recorded != given:
        if name in _DIGESTS:
            yield _DIGESTS[name]
        else:
            yield f"{name}: given {given}, recorded {recorded}"
