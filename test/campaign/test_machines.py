# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A study on a machine without a home, and with few open files for its processes."""

import os
import resource
import subprocess

from patience import PATIENCE

from sphere_nmpc.child import python_command

STUDY = ("study", "--draw", "2", "--seed", "1", "--duration", "1", "--jobs", "2", "--no-bound")


def test_study_without_a_home_and_with_few_files_has_its_results(tmp_path) -> None:
    program = "from sphere_sim.cli.main import main; sys.exit(main())"
    done = subprocess.run(
        python_command(program, *STUDY, "--out", str(tmp_path / "out")),
        # Not even root can create a folder there.
        env={**os.environ, "HOME": "/dev/null/home"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40)),
        capture_output=True, text=True, timeout=PATIENCE, cwd=tmp_path,
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert (tmp_path / "out" / "runs.csv").exists()
