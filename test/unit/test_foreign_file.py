# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files that a user names are read in bounded time and memory, or refused."""

import os
import re
import socket
import sys
from pathlib import Path

import pytest

from sphere_nmpc.foreign_file import InvalidFileError, find_file, read_file


def test_regular_file_is_read_whole(tmp_path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"\x00content")
    link = tmp_path / "link"
    link.symlink_to(file)
    assert read_file(file, 8) == read_file(link, 100) == b"\x00content"


def test_larger_file_is_refused_before_it_is_read(tmp_path) -> None:
    file = tmp_path / "file"
    with file.open("wb") as sparse:
        sparse.truncate(10**12)
    with pytest.raises(InvalidFileError, match="given '1000000000000 bytes', expected at most 9 "):
        read_file(file, 9)


def test_file_that_claims_to_be_empty_is_read_as_far_as_allowed() -> None:
    # Those of the kernel have a content all the same.
    assert read_file(Path("/proc/self/stat"), 10_000)
    with pytest.raises(InvalidFileError, match="given 'a file that grows', expected at most 5"):
        read_file(Path("/proc/self/stat"), 5)


def test_what_is_no_file_is_refused_at_once(tmp_path) -> None:
    pipe, at = tmp_path / "pipe", tmp_path / "socket"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(at))
        for path, kind in (
            (pipe, "a pipe"), (at, "a socket"), (Path("/dev/zero"), "a device"),
            (tmp_path, "a folder"),
        ):
            with pytest.raises(InvalidFileError, match=f"given '{kind}', expected a regular"):
                read_file(path, 10**6)
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "none", 10)


def test_relative_path_is_found_in_the_working_directory_before_the_share_folders(
    tmp_path, monkeypatch
) -> None:
    workspace, prefix = tmp_path / "workspace", tmp_path / "prefix"
    share = prefix / "share" / "sphere_nmpc"
    for folder in (workspace, share):
        (folder / "config").mkdir(parents=True)
    (share / "package.xml").touch()
    named = Path("config/hall.yaml")
    (share / named).touch()
    monkeypatch.chdir(workspace)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f":{tmp_path}:{prefix}")
    assert find_file(named) == share / named
    (workspace / named).touch()
    assert find_file(named) == workspace / named
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    monkeypatch.setattr(sys, "prefix", str(prefix))
    (workspace / named).unlink()
    assert find_file(named) == share / named
    # Neither installed nor in a workspace: the source tree.
    assert find_file(Path("config/maps/two_rooms.yaml")).is_file()


def test_path_that_is_not_found_says_where_was_looked(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidFileError) as caught:
        find_file(Path("none.yaml"))
    expected = f"none.yaml: given 'no such file', expected an existing file, {tmp_path}/none.yaml"
    assert re.match(rf"{re.escape(expected)} or /.*/none\.yaml$", str(caught.value))
    with pytest.raises(InvalidFileError, match=r"expected an existing file, /none\.yaml$"):
        find_file(Path("/none.yaml"))


def test_tilde_is_the_home(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "hall.yaml").touch()
    assert find_file(Path("~/hall.yaml")) == tmp_path / "hall.yaml"
