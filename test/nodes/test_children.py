# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What tests start ends with the test session."""

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import psutil
import pytest
from patience import PATIENCE

from sphere_nmpc.child import python_command

SESSION = (
    "import importlib.util, pytest; "
    "spec = importlib.util.spec_from_file_location('conftest', sys.argv[1]); "
    "plugin = importlib.util.module_from_spec(spec); spec.loader.exec_module(plugin); "
    "pytest.main(['-q', 'test_starting.py'], plugins=[plugin])"
)
STARTING = """
    import os, subprocess, sys, time
    from pathlib import Path

    def test_that_starts_processes():
        command = [sys.executable, "-c", "import time; time.sleep(1000)"]
        found = [
            subprocess.Popen(command, start_new_session=True),
            subprocess.Popen(command, preexec_fn=lambda: os.nice(1), stdout=subprocess.PIPE),
        ]
        text = " ".join(str(process.pid) for process in found)
        Path("fresh").write_text(text)
        os.replace("fresh", "pids")
        time.sleep(1000)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a signal of Linux")
def test_processes_that_a_test_has_started_end_when_pytest_is_killed(tmp_path) -> None:
    (tmp_path / "test_starting.py").write_text(textwrap.dedent(STARTING))
    conftest = str(Path(__file__).parents[1] / "conftest.py")
    session = subprocess.Popen(python_command(SESSION, conftest), cwd=tmp_path)
    try:
        end = time.monotonic() + PATIENCE
        while not (tmp_path / "pids").exists():
            assert session.poll() is None and time.monotonic() < end
            time.sleep(0.05)
        children = [psutil.Process(int(pid)) for pid in (tmp_path / "pids").read_text().split()]
        session.send_signal(signal.SIGKILL)
        session.wait(PATIENCE)
        _, alive = psutil.wait_procs(children, PATIENCE)
        for process in alive:
            process.kill()
        assert not alive
    finally:
        session.kill()
