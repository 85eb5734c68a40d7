# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A figure that cannot be drawn is a warning of one line."""

import sys
from pathlib import Path

import pytest

from sphere_sim.output.optional_figure import draw_or_warn


def test_drawn_figure_is_no_warning(tmp_path, caplog) -> None:
    assert draw_or_warn("study", "a.png", (tmp_path / "a.png").touch)
    assert (tmp_path / "a.png").exists() and not caplog.messages


def full_disk() -> None:
    raise OSError(28, "No space left on device", "a.png")


def missing_package() -> None:
    raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")


def library_fault() -> None:
    raise ValueError("no such\nfont")


@pytest.mark.parametrize(
    ("draw", "reason"),
    [
        (full_disk, "a.png: No space left on device"),
        (missing_package, "'matplotlib' is not installed; it comes with pip install"),
        (library_fault, "ValueError: no such font"),
    ],
)
def test_error_is_one_warning_that_names_the_file(draw, reason, caplog, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert not draw_or_warn("study", str(Path("out", "a.png")), draw)
    (warning,) = caplog.messages
    assert warning.startswith("sphere_nmpc study: out/a.png not drawn: ")
    assert reason in warning and "\n" not in warning


def test_interrupt_is_not_swallowed() -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_or_warn("study", "a.png", interrupt)
