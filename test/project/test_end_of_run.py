# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A test run leaves no process behind, however it is ended."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from patience import until

pytestmark = pytest.mark.slow

STUBBORN = """
import pathlib, signal, subprocess, sys, time
# Through a shell that ends, ignoring what asks it to end, in a session of its own.
child = "import os, signal, sys, time; [signal.signal(n, signal.SIG_IGN) for n in (1, 2, 15)]; " \\
    "open(sys.argv[1], 'w').write(str(os.getpid())); time.sleep(3600)"

def test_that_never_ends():
    subprocess.run(["sh", "-c", '"$0" -c "$1" "$2" &', sys.executable, child, PLACE],
                   start_new_session=True)
    time.sleep(3600)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_processes_of_a_run_that_is_ended_from_outside_end(tmp_path: Path, number: int) -> None:
    place = tmp_path / "pid"
    (tmp_path / "conftest.py").write_text(
        f"import sys\nsys.path.append({str(Path(__file__).parents[1] / 'support')!r})\n"
        "from end_of_run import end_with_this_process\nend_with_this_process()\n"
    )
    (tmp_path / "test_run.py").write_text(f"PLACE = {str(place)!r}\n{STUBBORN}")
    outside = {k: v for k, v in os.environ.items() if k != "SPHERE_NMPC_TEST_RUN"}
    run = subprocess.Popen([sys.executable, "-m", "pytest", str(tmp_path)], cwd=tmp_path,
                           env=outside, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
    until(lambda: place.exists() and place.read_text())
    left = Path("/proc", place.read_text(), "cmdline")
    assert str(place) in left.read_text()
    run.send_signal(number)
    run.wait()
    until(lambda: not left.exists() or str(place) not in left.read_text())
