# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A test run leaves no process behind, however it is ended."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from children import wait_for_end
from patience import until

pytestmark = pytest.mark.slow

CONFTEST = """
import sys
sys.path.append({support!r})
from end_of_run import end_with_this_process
end_with_this_process()
"""
STUBBORN = """
import os, subprocess, sys, time
# Through a shell that ends, ignoring what asks it to end, in a session of its own.
child = "import os, signal, sys, time; [signal.signal(n, signal.SIG_IGN) for n in (1, 2, 15)]; " \\
    "open(sys.argv[1], 'w').write(f'{os.getpid()} {os.environ[\\"SPHERE_NMPC_TEST_RUN\\"]}.'); " \\
    "time.sleep(3600)"

def test_that_never_ends():
    subprocess.run(["sh", "-c", '"$0" -c "$1" "$2" &', sys.executable, child, __file__ + ".pid"],
                   start_new_session=True)
    time.sleep(3600)
"""
MAKEFILE = """
alone:
\t{pytest}
loop:
\tfor once in 1; do {pytest} || exit 1; done
"""
WORKERS = 2


class Run:
    """A run of two tests that never end in a worker each, started by a rule of a Makefile."""

    def __init__(self, folder: Path, rule: str) -> None:
        pytest_command = f"{sys.executable} -m pytest -n {WORKERS} --dist loadfile {folder}"
        (folder / "conftest.py").write_text(
            CONFTEST.format(support=str(Path(__file__).parents[1] / "support"))
        )
        (folder / "Makefile").write_text(MAKEFILE.format(pytest=pytest_command))
        files = [folder / f"test_{number}.py" for number in range(WORKERS)]
        for file in files:
            file.write_text(STUBBORN)
        outside = {k: v for k, v in os.environ.items()
                   if k not in ("SPHERE_NMPC_TEST_RUN", "MAKELEVEL") and "PYTEST" not in k}
        self.make = subprocess.Popen(
            ["make", rule], cwd=folder, env=outside, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )
        self.left: list[int] = []
        """Process ids of what the tests have started."""
        self.workers: list[int] = []
        for place in [file.with_name(f"{file.name}.pid") for file in files]:
            until(lambda place=place: place.exists() and place.read_text().endswith("."))
            child, mark = place.read_text()[:-1].split()
            _, self.pytest, worker = map(int, f"0{mark}".split("/"))
            self.left.append(int(child))
            self.workers.append(worker)


@pytest.fixture
def run(request, tmp_path) -> Iterator[Run]:
    pytest.importorskip("xdist")
    if shutil.which("make") is None:
        pytest.skip("no make here")
    run = Run(tmp_path, request.param)
    yield run
    run.make.kill()
    run.make.wait()
    wait_for_end([run.pytest, *run.workers, *run.left])


@pytest.mark.parametrize(
    ("run", "ended", "number"),
    [
        ("alone", "make", signal.SIGKILL), ("alone", "make", signal.SIGHUP),
        ("loop", "make", signal.SIGTERM), ("alone", "pytest", signal.SIGKILL),
    ],
    indirect=["run"],
)
def test_what_a_worker_or_a_run_has_started_ends_with_it_and_a_run_with_its_make(
    run, ended, number
) -> None:
    os.kill(run.workers[0], signal.SIGKILL)
    wait_for_end([run.workers[0], run.left[0]])
    assert run.make.poll() is None, "the run goes on"
    os.kill(run.make.pid if ended == "make" else run.pytest, number)
    until(lambda: run.make.poll() is not None)
    wait_for_end([run.pytest, *run.workers, *run.left])
