# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Duration of the steps of a new user from `git clone` to a goal dragged in the browser.

    python bench/newcomer.py                                      # about five minutes

Follows README.md in a new folder, without the environment of this interpreter: clone, `make demo`
at a terminal, open the page that it prints in a headless Chromium, drag the goal by its arrow,
wait until the sphere has arrived there, and press Enter.
"""

import argparse
import os
import re
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "test" / "sphere_sim" / "viewer"))

from browser import Browser, find_browser  # noqa: E402
from page_helpers import pixel  # noqa: E402

_COLOUR = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
_PATIENCE = 1800.0
"""Longest wait for any step [s]."""


class Stopwatch:
    """Prints the duration of each step."""

    def __init__(self) -> None:
        self.began = self.last = time.monotonic()

    def lap(self, step: str) -> None:
        now = time.monotonic()
        print(f"| {step} | {now - self.last:.1f} | {now - self.began:.1f} |", flush=True)
        self.last = now


def wait_for(terminal: int, pattern: str, output: list[str]) -> re.Match[str]:
    """Return the match of a pattern in the terminal's output, which is collected meanwhile."""
    end = time.monotonic() + _PATIENCE
    while not (found := re.search(pattern, _COLOUR.sub("", "".join(output)))):
        assert time.monotonic() < end, "".join(output)
        if select.select([terminal], [], [], 0.2)[0]:
            output.append(os.read(terminal, 65536).decode(errors="replace"))
    return found


def distance(page: Browser) -> float:
    """Return the distance to the goal that the page shows [m]."""
    found = re.search(r"to the goal: ([\d.]+) m", page.text)
    return float(found.group(1)) if found else float("nan")


def wait_until_distance(page: Browser, low: float, high: float) -> None:
    end = time.monotonic() + 120.0
    while not low <= distance(page) < high:
        assert time.monotonic() < end, page.text
        time.sleep(0.2)


def clean_environment() -> dict[str, str]:
    """Return the environment without the variables that this interpreter's packages have set."""
    own = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "VIRTUAL_ENV", "ROS_DOMAIN_ID")
    return {name: value for name, value in os.environ.items() if name not in own}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--source", default=str(ROOT), help="what to clone")
    given = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} at the start\n\n| step | took [s] | since [s] |\n"
          "|---|---|---|")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        watch, clone = Stopwatch(), Path(folder) / "sphere_nmpc"
        subprocess.run(["git", "clone", "--quiet", given.source, clone], check=True)
        watch.lap("`git clone`")
        terminal, other = os.openpty()
        process = subprocess.Popen(
            ["make", "demo"], cwd=clone, stdin=other, stdout=other, stderr=other,
            env={**clean_environment(), "XDG_CACHE_HOME": f"{folder}/cache",
                 "PIP_CACHE_DIR": f"{folder}/pip"},
        )
        output: list[str] = []
        wait_for(terminal, "case 1 of the paper", output)
        watch.lap("`make demo`: everything installed")
        page_named = r"http://127\.0\.0\.1:\d+/\?token=[\w-]+(?=[\s\x1b])"
        address = wait_for(terminal, page_named, output).group()
        watch.lap("nodes ready, page printed")
        home = Path(folder) / "browser"
        home.mkdir()
        with Browser(find_browser() or "", home) as page:
            page.open(address)
            page.wait_for("live")
            page.settle()
            watch.lap("page opened, scene drawn (without a graphics card)")
            wait_for(terminal, "the nodes run on", output)
            watch.lap("case 1 run, measured, compared, drawn")
            page.drag(pixel(page, (0.5, 0.0, 0.3)), pixel(page, (1.5, 0.0, 0.3)))
            wait_until_distance(page, 0.3, 9.0)
            watch.lap("goal dragged")
            wait_until_distance(page, 0.0, 0.02)
            watch.lap("sphere at the dragged goal")
        os.write(terminal, b"\n")
        print(f"\n`make demo` ended with {process.wait(60.0)}; load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
