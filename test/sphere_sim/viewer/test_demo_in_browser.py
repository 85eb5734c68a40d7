# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo as somebody at a terminal sees it: a page to watch the run, and then to steer it."""

import os
import re
import select
import subprocess
import sys
import time

import psutil
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import Browser, find_browser

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]


class Terminal:
    """A command in a terminal of its own."""

    def __init__(self, *command: str) -> None:
        self._own, other = os.openpty()
        environment = {**os.environ, "TERM": "dumb", "COLUMNS": "200"}
        self.process = subprocess.Popen(
            command, stdin=other, stdout=other, stderr=other, env=environment
        )
        os.close(other)
        self.said = ""

    def wait_for(self, pattern: str, patience: float) -> re.Match:
        """Return what was said once it matches."""
        end = time.monotonic() + patience
        while not (found := re.search(pattern, self.said)):
            assert time.monotonic() < end and self.process.poll() is None, self.said
            if select.select([self._own], [], [], 0.1)[0]:
                self.said += os.read(self._own, 65536).decode(errors="replace")
        return found

    def enter(self) -> None:
        os.write(self._own, b"\n")

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(20.0)
        os.close(self._own)


def test_demo_shows_the_run_and_leaves_the_sphere_to_who_watches(tmp_path) -> None:
    parent = str(os.getpid())
    terminal = Terminal(
        sys.executable, "-m", "sphere_sim.cli.child", parent, "demo", "--case", "3",
        "--no-compare", "--out", str(tmp_path / "out"),
    )
    home = tmp_path / "browser"
    home.mkdir()
    try:
        address = terminal.wait_for(r"http://127\.0\.0\.1:\d+", 90.0).group()
        children = psutil.Process(terminal.process.pid).children(recursive=True)
        assert len(children) == 4
        terminal.wait_for("the sphere is yours", 120.0)
        assert (tmp_path / "out" / "summary.json").exists()
        with Browser(BROWSER, home) as page:
            page.open(address)
            page.wait_for("live", 60.0)
            assert re.search(r"to the goal: 0\.0", page.text)
            page.choose("pick a goal …", "start of the paper's case 1")
            end = time.monotonic() + 30.0
            while not re.search(r"to the goal: [123]\.", page.text):
                assert time.monotonic() < end, page.text
            assert page.console == []
        terminal.enter()
        assert terminal.process.wait(30.0) == 0, terminal.said
    finally:
        terminal.close()
    assert not [child for child in children if child.is_running()]
