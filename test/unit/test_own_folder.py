# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders for kept files are this user's alone, or refused."""

import os
import tempfile
from pathlib import Path

import pytest

from sphere_nmpc.own_folder import cache_folder, own_folder


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


def test_link_is_not_followed(tmp_path) -> None:
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "nowhere").symlink_to(tmp_path / "made")
    for name in ("link", "nowhere"):
        with pytest.raises(OSError, match=f"{name}: given a link, expected"):
            own_folder(tmp_path / name)
    assert not (tmp_path / "made").exists()


def test_folder_of_another_user_is_refused(tmp_path, monkeypatch) -> None:
    made = own_folder(tmp_path / "folder")
    monkeypatch.setattr(os, "geteuid", lambda: made.stat().st_uid + 1)
    with pytest.raises(OSError, match=r"a folder of user \d+, expected one of user \d+ with"):
        own_folder(made)


def test_user_without_a_home_has_a_cache_in_the_temporary_folder(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(os.path, "expanduser", str)  # as without HOME and without an entry
    for given in (None, "", "relative"):
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
        if given is not None:
            monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert cache_folder() == tmp_path / f"sphere_nmpc-{os.getuid()}"
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache_folder() == Path("/somewhere/sphere_nmpc")
