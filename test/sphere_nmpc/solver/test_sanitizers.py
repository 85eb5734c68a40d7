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

from sphere_nmpc.cache import CACHE_VARIABLE

pytestmark = pytest.mark.slow

RUNS = Path(sanitized_runs.__file__)
SANITIZE = "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -g -O1"
RUNTIMES = {
    "libasan.so": SANITIZE,
    f"libclang_rt.asan-{platform.machine()}.so": f"{SANITIZE} -shared-libasan",
}
"""Runtime library of the address sanitiser of GCC and of Clang, and their options."""


@pytest.fixture(scope="module")
def sanitizers(tmp_path_factory):
    """Return the variables of a process that uses the solver with the sanitisers."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("sanitizers")
    source = folder / "empty.c"
    source.write_text("int main(void) { return 0; }\n")
    for name, options in RUNTIMES.items():
        printed = subprocess.run(
            [compiler, f"-print-file-name={name}"], capture_output=True, text=True, check=True
        )
        runtime = printed.stdout.strip()
        command = [compiler, *options.split(), str(source), "-o", str(folder / "empty")]
        if Path(runtime).is_absolute() and subprocess.run(command, check=False).returncode == 0:
            # After the options of the solver: less optimised, in two thirds of the time.
            wrapper = folder / "cc"
            wrapper.write_text(f'#!/bin/sh\nexec {compiler} "$@" {options}\n')
            wrapper.chmod(0o755)
            return {
                "CC": str(wrapper), "LD_PRELOAD": runtime,
                CACHE_VARIABLE: str(folder / "cache"), "TMPDIR": str(folder),
                # The interpreter frees little of its memory at its end.
                "ASAN_OPTIONS": "detect_leaks=0",
            }
    pytest.skip("the C compiler has no sanitisers")


def run(sanitizers, *fault):
    """Use the solver with the sanitisers, and with a fault if one is given."""
    return subprocess.run(
        [sys.executable, str(RUNS), *fault], env={**os.environ, **sanitizers},
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )


def test_solves_and_roll_outs_break_no_rule_of_the_language(sanitizers):
    done = run(sanitizers)
    assert done.returncode == 0 and done.stdout.endswith("all done\n"), done.stderr


@pytest.mark.parametrize("fault", sanitized_runs.FAULTS)
def test_fault_put_into_the_source_is_found(sanitizers, fault):
    done = run(sanitizers, fault)
    assert done.returncode != 0
    assert "AddressSanitizer" in done.stderr or "runtime error" in done.stderr, done.stderr
