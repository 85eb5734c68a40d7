# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files that a user names are bounded, and folders for kept files this user's, or refused."""

import os
import re
import socket
import sys
import tempfile
from pathlib import Path
from unittest import mock

import pytest

from sphere_nmpc.foreign.file import InvalidFileError, find_file, read_file
from sphere_nmpc.foreign.own_folder import cache_folder, own_folder
from sphere_nmpc.ros.network import unwritable_log_folder


def test_regular_file_is_read_whole_and_no_other_one(tmp_path) -> None:
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_bytes(b"\x00content")
    link.symlink_to(file)
    assert read_file(file, 8) == read_file(link, 100) == b"\x00content"
    # Files of the kernel claim to be empty, but have a content all the same.
    kernel = Path("/proc/self/stat")
    assert read_file(kernel, 10_000)
    with (tmp_path / "large").open("wb") as sparse:
        sparse.truncate(10**12)
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        for path, longest, told in (
            (tmp_path / "large", 9, "given 1000000000000 bytes, expected at most 9 "),
            (kernel, 5, "given a file that grows, expected at most 5"),
            (tmp_path / "pipe", 10**6, "given a pipe, expected a regular"),
            (tmp_path / "socket", 10**6, "given a socket, expected a regular"),
            (Path("/dev/zero"), 10**6, "given a device, expected a regular"),
            (tmp_path, 10**6, "given a folder, expected a regular"),
            (tmp_path / "\0", 10**6, "given a name with a NUL, expected the name"),
        ):
            with pytest.raises(InvalidFileError, match=told):
                read_file(path, longest)
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
    monkeypatch.setenv("HOME", str(workspace))
    (workspace / "hall.yaml").touch()
    assert find_file(Path("~/hall.yaml")) == workspace / "hall.yaml"


def test_path_that_is_not_found_says_where_was_looked(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    told = re.escape("none.yaml: given no such file, expected an existing file at")
    for path, expected in (
        ("none.yaml", rf"^{told} {re.escape(str(tmp_path))}/none\.yaml or /.*/none\.yaml$"),
        ("/none.yaml", r"expected an existing file at /none\.yaml$"),
    ):
        with pytest.raises(InvalidFileError, match=expected):
            find_file(Path(path))


def test_new_folder_and_one_that_others_could_read_are_private(tmp_path) -> None:
    for folder in (tmp_path / "a" / "new", tmp_path / "open"):
        (tmp_path / "open").mkdir(exist_ok=True)
        (tmp_path / "open").chmod(0o755)
        assert own_folder(folder) == own_folder(folder) == folder
        assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o770, 0o702, 0o1777])
def test_folder_that_others_can_write_is_refused(tmp_path, mode) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(mode)
    with pytest.raises(OSError, match=rf"given a folder .*, mode {mode:o}, expected one of"):
        own_folder(tmp_path / "shared")
    assert (tmp_path / "shared").stat().st_mode & 0o7777 == mode


def test_link_file_and_folder_of_another_user_are_refused(tmp_path, monkeypatch) -> None:
    made = own_folder(tmp_path / "real")
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "nowhere").symlink_to(tmp_path / "made")
    (tmp_path / "file").touch()
    for name, given in (("link", "a link"), ("nowhere", "a link"), ("file", "no folder")):
        with pytest.raises(OSError, match=f"{name}: given {given}, expected"):
            own_folder(tmp_path / name)
    assert not (tmp_path / "made").exists()
    monkeypatch.setattr(os, "geteuid", lambda: made.stat().st_uid + 1)
    with pytest.raises(OSError, match=r"a folder of user \d+, expected one of user \d+ with"):
        own_folder(made)


def test_user_without_a_home_has_a_cache_in_the_temporary_folder(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    missing = str(tmp_path / "missing")
    without_entry = mock.patch.object(os.path, "expanduser", str)  # nor HOME
    for home in (without_entry, mock.patch.dict(os.environ, HOME=missing)):
        for given in (None, "", "relative"):
            monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
            if given is not None:
                monkeypatch.setenv("XDG_CACHE_HOME", given)
            with home:
                assert cache_folder() == tmp_path / f"sphere_nmpc-{os.getuid()}"
    assert unwritable_log_folder({"HOME": missing}) is not None
    assert not Path(missing).exists()
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache_folder() == Path("/somewhere/sphere_nmpc")
