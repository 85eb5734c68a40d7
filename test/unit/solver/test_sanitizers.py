# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver under the address and undefined-behaviour sanitisers of the C compiler."""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import sanitized_runs
from patience import PATIENCE

pytestmark = pytest.mark.slow

RUNS = Path(sanitized_runs.__file__)
OPTIONS = (
    "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -g -O0 -std=gnu11 "
    "-march=native -ffp-contract=fast -fno-math-errno -Wno-psabi -shared -fPIC"
)
RUNTIMES = {
    "libasan.so": OPTIONS,
    f"libclang_rt.asan-{platform.machine()}.so": f"{OPTIONS} -shared-libasan",
}
"""Runtime library of the address sanitiser of GCC and of Clang, and their options."""


@pytest.fixture(scope="module")
def sanitizers(tmp_path_factory):
    """Return a folder with the solver built with sanitisers, and the variables of a process."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("sanitizers")
    sanitized_runs.write_sources(folder)
    for name, options in RUNTIMES.items():
        printed = subprocess.run(
            [compiler, f"-print-file-name={name}"], capture_output=True, text=True, check=True
        )
        runtime = printed.stdout.strip()
        command = [compiler, *options.split(), "solver.c", "-o", "solver.so", "-lm"]
        if Path(runtime).is_absolute():
            subprocess.run(command, check=True, cwd=folder)
            # The interpreter frees little of its memory at its end.
            return folder, {"LD_PRELOAD": runtime, "ASAN_OPTIONS": "detect_leaks=0"}
    pytest.skip("the C compiler has no sanitisers")


@pytest.mark.parametrize("is_faulty", [False, True], ids=["as it is", "with a fault put in"])
def test_solves_and_roll_outs_break_no_rule_of_the_language(sanitizers, is_faulty):
    folder, environment = sanitizers
    if is_faulty:
        environment = {**environment, "SOLVER_FAULT": "1"}
    done = subprocess.run(
        [sys.executable, str(RUNS), str(folder)], env={**os.environ, **environment},
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )
    is_told = "AddressSanitizer" in done.stderr or "runtime error" in done.stderr
    if is_faulty:
        assert done.returncode != 0 and is_told, done.stderr
    else:
        assert done.returncode == 0 and done.stdout.endswith("all done\n"), done.stderr
