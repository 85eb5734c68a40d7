# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Storage files of a bag, with or without its metadata.yaml."""

import json
import re
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from sphere_nmpc.errors import SphereNmpcError, printable_line, shown
from sphere_nmpc.foreign.file import InvalidFileError, open_file, read_file, yaml_texts

METADATA = "metadata.yaml"
PARAMETERS_PREFIX = "parameters:"
"""Custom data under this prefix and a node's full name hold the node's parameters as JSON."""
TOPICS_PREFIX = "topics:"
"""Custom data under this prefix and a namespace has the full names of topics there as JSON, by
their names before any remapping."""
_MOST_METADATA = 1 << 22
"""Bytes of metadata.yaml, for which its parser takes a second; a thousand topics have 1 MB."""
_DEEPEST_METADATA = 10
"""Levels of its lists and mappings, of which recorders have seven."""
_ZSTD = ".zstd"
_HEAD, _MOST_OTHERS = 32, 100
"""Bytes at the beginning of a file that show its format, and files of a folder whose is shown."""
_SUFFIXES = (".mcap", ".db3")
OF_ROS_1 = "'rosbags-convert --src FILE.bag --dst FOLDER' converts a bag of ROS 1"
_BEGINNINGS = {".mcap": b"\x89MCAP0", ".db3": b"SQLite format 3", _ZSTD: b"\x28\xb5\x2f\xfd"}
"""What files with these suffixes begin with."""
_FORMATS = {
    b"#ROSBAG V": f"a recording of ROS 1; {OF_ROS_1}",
    b"ULog": "a log of PX4 (ULog)",
    b"version https://git-lfs": "a pointer of Git LFS to the file, which 'git lfs pull' fetches",
    b"\x1f\x8b": "compressed with gzip",
    b"PK\x03\x04": "a ZIP archive",
    **{begin: f"a file whose name should end in {suffix}" for suffix, begin in
       _BEGINNINGS.items()},
}
"""What files are that begin so, and are not what their suffix says."""
_EXPECTED = "a folder, a .mcap or a .db3 file, also with the suffix .zstd"


class BagError(SphereNmpcError):
    """Bag that cannot be written or read; the message names the bag and the reason."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"bag {path}: {printable_line(reason)}")


def full_topic_name(name: str) -> str:
    """Return a name with its leading slash, which some writers of bags leave out."""
    return f"/{name.strip('/')}"


def last_part(topic: str) -> str:
    """Return the last part of a full name."""
    return topic.rpartition("/")[2]


def one_line_reason(error: Exception) -> str:
    """Return the message of an error in one line; its type where it has no message."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


@dataclass
class BagFiles:
    """Storage files of a bag, in the order in which they were written.

    `described` says whether metadata.yaml, or the user, names them as one bag; `custom_data` and
    `message_count` are those in metadata.yaml, empty where it does not count just these files, and
    `notes` are messages for users on what is missing or ignored.
    """

    files: list[Path]
    described: bool = False
    custom_data: dict[str, str] = field(default_factory=dict)
    message_count: str = ""
    notes: list[str] = field(default_factory=list)


def find_files(path: Path) -> BagFiles:
    """Find the storage files of a bag: a folder, or a single storage file.

    Raises `BagError` if there is none, their compression is unknown, or they are of several bags.
    """
    if not path.exists():
        raise BagError(path, "there is no such file or folder")
    if not path.is_dir():
        return _single(path)
    present = {storage_name(file): file for file in _storage_files(path)}
    if not present:
        inside = sorted(it.name for it in path.iterdir() if it.is_dir() and _storage_files(it))
        hint = f"; there is one in {', '.join(inside)}" if inside else ""
        others = {file.name: _format_of(file) for file in sorted(path.iterdir())[:_MOST_OTHERS]}
        hint += "".join(f"; {name} is {kind}" for name, kind in others.items() if kind)
        raise BagError(path, f"is not a bag: the folder holds no .mcap or .db3 file{hint}")
    found = BagFiles(list(present.values()))
    if not (path / METADATA).exists():
        found.notes.append(f"{METADATA} is missing, the storage was read without it")
    else:
        try:
            values = metadata_values(read_file(path / METADATA, _MOST_METADATA))
            information = values["rosbag2_bagfile_information"]
            names = [PurePath(name).name for name in information["relative_file_paths"]]
        except Exception as error:
            # A damaged file raises errors of YAML, of the text encoding, KeyError and others.
            reason = one_line_reason(error)
            found.notes.append(f"{METADATA} is ignored, it cannot be read ({reason})")
        else:
            _describe(path, found, information, names, present)
    if not found.described:
        _refuse_several(path, found.files)
    return found


def storage_name(file: PurePath) -> str:
    """Return the name of a storage file without the suffix of its compression."""
    return file.name.removesuffix(_ZSTD)


def metadata_values(text: str | bytes) -> Any:
    """Return the metadata of a bag, see `yaml_texts`; raises as it does, or if it is too long."""
    if len(text) > _MOST_METADATA:
        raise InvalidFileError(METADATA, f"{len(text)} bytes", f"at most {_MOST_METADATA} bytes")
    return yaml_texts(text, _DEEPEST_METADATA)


def custom_data(information: Any) -> dict[str, str]:
    """Return the custom data in the metadata of a bag as rosbag2 structures it."""
    custom = information.get("custom_data") if isinstance(information, dict) else None
    if not isinstance(custom, dict):
        return {}
    return {key: value for key, value in custom.items() if isinstance(value, str)}


def object_of(text: str) -> dict[str, Any]:
    """Return the JSON object in custom data; empty where there is none."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def foreign_format(head: bytes, suffix: str) -> str:
    """Return what a file is, by its first bytes; empty where it may be what its suffix says."""
    own = _BEGINNINGS.get(suffix, b"")
    if own and head.startswith(own):
        return ""
    return next((kind for begin, kind in _FORMATS.items() if head.startswith(begin)), "")


def _format_of(file: Path) -> str:
    try:
        with open_file(file) as stream:
            return foreign_format(stream.read(_HEAD), file.suffix)
    except (OSError, InvalidFileError):
        return ""


def _single(path: Path) -> BagFiles:
    if not storage_name(path).endswith(_SUFFIXES):
        kind = _format_of(path)
        found = f"it is {kind}; " if kind else ""
        raise BagError(path, f"is not a bag: {found}expected {_EXPECTED}")
    bag = BagFiles([path], described=True)
    others = [
        file.name for file in _storage_files(path.parent)
        if storage_name(file) != storage_name(path) and _recording(file) == _recording(path)
    ]
    if others:
        bag.notes.append(f"only {path.name} was read, not {', '.join(others)} beside it")
    return bag


def _storage_files(folder: Path) -> list[Path]:
    """Return the storage files of a folder in order of their numbers.

    ``ros2 bag play`` leaves a decompressed file beside the original, which is then ignored.
    """
    files = [file for file in folder.iterdir() if storage_name(file).endswith(_SUFFIXES)]
    plain = {file.name for file in files if file.suffix != _ZSTD}
    return sorted(
        (file for file in files if file.suffix != _ZSTD or storage_name(file) not in plain),
        # Within a recording shorter numbers come first.
        key=lambda file: (_recording(file), len(storage_name(file)), file.name),
    )


def _recording(file: Path) -> tuple[str, str]:
    """Return name without number, and suffix, which the files of one recording share."""
    name = PurePath(storage_name(file))
    return re.sub(r"_\d+$", "", name.stem), name.suffix


def _describe(
    path: Path, found: BagFiles, information: Any, names: list[str], present: dict[str, Path]
) -> None:
    """Apply the contents of metadata.yaml, with notes where the folder differs from it."""
    compression = str(information.get("compression_format") or "")
    if compression not in ("", "zstd"):
        reason = f"is compressed with {shown(compression)}, expected 'zstd' or nothing"
        raise BagError(path, reason)
    # Users may have decompressed the files, and old recorders do not list the suffix.
    named = {storage_name(PurePath(name)): name for name in names}
    files = [present[key] for key in named if key in present]
    missing = [name for key, name in named.items() if key not in present]
    unlisted = [file.name for key, file in present.items() if key not in named]
    if missing:
        found.notes.append(f"{', '.join(missing)} is missing, though {METADATA} lists it")
    if not files:
        found.notes.append(f"none of the files that {METADATA} lists exists; it is ignored")
        return
    if unlisted:
        found.notes.append(f"{', '.join(unlisted)} was ignored: {METADATA} does not list it")
    found.files, found.described = files, True
    count = information.get("message_count")
    found.message_count = count if isinstance(count, str) and not missing else ""
    found.custom_data = custom_data(information)


def _refuse_several(path: Path, files: list[Path]) -> None:
    """Raise if the files are of several bags; the metrics of mixed runs would be meaningless."""
    names = sorted({"".join(_recording(file)) for file in files})
    if len(names) > 1:
        raise BagError(
            path, f"holds files of several bags ({', '.join(names)}) and no {METADATA} that "
            "lists the files of one; give one of the files"
        )
