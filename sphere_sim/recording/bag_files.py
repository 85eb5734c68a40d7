# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Which files make up a bag, with or without its metadata.yaml."""

import re
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from ruamel.yaml import YAML

from sphere_sim.recording.errors import BagError

METADATA = "metadata.yaml"
_ZSTD = ".zstd"
_SUFFIXES = (".mcap", ".db3")
_EXPECTED = "a folder, a .mcap or a .db3 file, also with .zstd behind"


@dataclass
class BagFiles:
    """The storage files of a bag.

    Attributes
    ----------
    files : list of Path
        In the order in which they were written.
    described : bool
        Whether metadata.yaml says that they belong together.
    custom_data : dict of str to str
        What metadata.yaml says about the run.
    notes : list of str
        What is missing or left out, for people.
    """

    files: list[Path]
    described: bool = False
    custom_data: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def find_files(path: Path) -> BagFiles:
    """Return the storage files of a bag.

    Parameters
    ----------
    path : Path
        Folder with or without metadata.yaml, or a single storage file.

    Raises
    ------
    BagError
        If there is none, their compression is not known, or they are of several bags.
    """
    if not path.exists():
        raise BagError(path, "there is no such file or folder")
    if path.is_file():
        return _single(path)
    present = {storage_name(file): file for file in _storage_files(path)}
    if not present:
        inside = sorted(it.name for it in path.iterdir() if it.is_dir() and _storage_files(it))
        hint = f"; there is one in {', '.join(inside)}" if inside else ""
        raise BagError(path, f"is no bag: the folder holds no .mcap or .db3 file{hint}")
    found = BagFiles(list(present.values()))
    if not (path / METADATA).exists():
        found.notes.append(f"{METADATA} is missing, the storage was read without it")
    else:
        try:
            yaml = YAML(typ="safe").load((path / METADATA).read_text(encoding="utf-8"))
            information = yaml["rosbag2_bagfile_information"]
            names = [PurePath(str(name)).name for name in information["relative_file_paths"]]
        except Exception as error:
            # A damaged file raises anything: YAML's errors, those of a text's encoding, KeyError.
            reason = " ".join(str(error).split()) or type(error).__name__
            found.notes.append(f"{METADATA} is left out, it cannot be read ({reason})")
        else:
            _describe(path, found, information, names, present)
    if not found.described:
        _refuse_several(path, found.files)
    return found


def storage_name(file: PurePath) -> str:
    """Return the name of a storage file before it was compressed."""
    return file.name.removesuffix(_ZSTD)


def custom_data(information: Any) -> dict[str, str]:
    """Return what a recorder said about the run, from metadata in the words of rosbag2."""
    custom = information.get("custom_data") if isinstance(information, dict) else None
    return {str(key): str(it) for key, it in custom.items()} if isinstance(custom, dict) else {}


def _single(path: Path) -> BagFiles:
    if not storage_name(path).endswith(_SUFFIXES):
        raise BagError(path, f"is no bag: expected {_EXPECTED}")
    found = BagFiles([path], described=True)
    others = [
        file.name for file in _storage_files(path.parent)
        if storage_name(file) != storage_name(path) and _recording(file) == _recording(path)
    ]
    if others:
        found.notes.append(f"only {path.name} was read, not {', '.join(others)} beside it")
    return found


def _storage_files(folder: Path) -> list[Path]:
    """Return the storage files in order of their numbers.

    ``ros2 bag play`` leaves what it decompressed beside the original, which is then left out.
    """
    files = [file for file in folder.iterdir() if storage_name(file).endswith(_SUFFIXES)]
    plain = {file.name for file in files if file.suffix != _ZSTD}
    return sorted(
        (file for file in files if file.suffix != _ZSTD or storage_name(file) not in plain),
        key=lambda file: (_recording(file), _number(file), file.name),
    )


def _recording(file: Path) -> tuple[str, str]:
    """Return what the files of one recording have in common: their name less the number."""
    name = PurePath(storage_name(file))
    return re.sub(r"_\d+$", "", name.stem), name.suffix


def _number(file: Path) -> int:
    found = re.search(r"_(\d+)$", PurePath(storage_name(file)).stem)
    return int(found.group(1)) if found else -1


def _describe(
    path: Path, found: BagFiles, information: Any, names: list[str], present: dict[str, Path]
) -> None:
    """Take over what metadata.yaml says, and note where the folder differs."""
    compression = str(information.get("compression_format") or "")
    if compression not in ("", "zstd"):
        raise BagError(path, f"is compressed with '{compression}', expected 'zstd' or nothing")
    # Somebody may have decompressed the files by hand, and old recorders do not name the suffix.
    named = {storage_name(PurePath(name)): name for name in names}
    files = [present[key] for key in named if key in present]
    missing = [name for key, name in named.items() if key not in present]
    strange = [file.name for key, file in present.items() if key not in named]
    if missing:
        found.notes.append(f"{', '.join(missing)} is missing, though {METADATA} names it")
    if not files:
        found.notes.append(f"none of the files that {METADATA} names is there; it is left out")
        return
    if strange:
        found.notes.append(f"{', '.join(strange)} was left out: {METADATA} does not name it")
    found.files, found.described = files, True
    found.custom_data = custom_data(information)


def _refuse_several(path: Path, files: list[Path]) -> None:
    """Refuse to mix runs: their mixture would have figures that are of neither."""
    names = sorted({"".join(_recording(file)) for file in files})
    if len(names) > 1:
        raise BagError(
            path, f"holds files of several bags ({', '.join(names)}) and no {METADATA} that tells "
            "which belong together; give one of the files"
        )
