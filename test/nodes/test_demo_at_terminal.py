# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Demo at a terminal: a page that shows the run, and nodes that run on until Enter."""

import os
import re
import select
import subprocess
import time
import urllib.request

import psutil
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from patience import PATIENCE

from sphere_sim.ros.session.process_set import verb_command


@pytest.mark.slow
def test_demo_shows_its_page_and_runs_on_until_enter(tmp_path) -> None:
    own, other = os.openpty()
    demo = subprocess.Popen(
        verb_command("demo", "--case", "3", "--no-compare", "--out", str(tmp_path / "out")),
        stdin=other, stdout=other, stderr=other,
        env={**os.environ, "TERM": "dumb", "COLUMNS": "200"},
    )
    os.close(other)
    output, end = "", time.monotonic() + PATIENCE
    try:
        while "the nodes run on" not in output:
            assert time.monotonic() < end and demo.poll() is None, output
            if select.select([own], [], [], 0.1)[0]:
                output += os.read(own, 65536).decode(errors="replace")
        children = psutil.Process(demo.pid).children(recursive=True)
        assert len(children) == 4, "three nodes, as the recording is over, and a worker"
        assert (tmp_path / "out" / "summary.json").exists()
        address = re.search(r"http://127\.0\.0\.1:\d+/\?token=[\w-]+(?=[\s\x1b])", output).group()
        with urllib.request.urlopen(address, timeout=PATIENCE) as page:
            assert page.status == 200
        os.write(own, b"\n")
        assert demo.wait(PATIENCE) == 0
    finally:
        if demo.poll() is None:
            demo.terminate()
            demo.wait(PATIENCE)
        os.close(own)
    assert not [child for child in children if child.is_running()]
