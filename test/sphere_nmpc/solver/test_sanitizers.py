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
from patience import PATIENCE

from sphere_nmpc.cache import CACHE_VARIABLE

pytestmark = pytest.mark.slow

RUNS = Path(__file__).with_name("sanitized_runs.py")
SANITIZE = "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -g -O1"
RUNTIMES = {
    "libasan.so": SANITIZE,
    f"libclang_rt.asan-{platform.machine()}.so": f"{SANITIZE} -shared-libasan",
}
"""Runtime library of the address sanitiser of GCC and of Clang, and their options."""

FAULTS = {
    "part too short": ("workspace.h", "take(base, &used, m + 2)", "take(base, &used, m)"),
    "interval past the last": ("shooting.h", "m = n; m-- > 0;", "m = n; m >= 0; m--"),
    "index past a row": ("shooting.h", "[k][2 + k] = 1.0", "[k][6 + k] = 1.0"),
}
"""File, text and what replaces it."""


@pytest.fixture(scope="module")
def sanitizers(tmp_path_factory):
    """Return the compiler command with the sanitisers' options, and their runtime library."""
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
            return f"{compiler} {options}", runtime
    pytest.skip("the C compiler has no sanitisers")


def run(sanitizers, tmp_path, *fault):
    """Build the solver with the sanitisers, and with a fault if one is given, and use it."""
    command, runtime = sanitizers
    return subprocess.run(
        [sys.executable, str(RUNS), *fault],
        env={
            **os.environ, "CC": command, "LD_PRELOAD": runtime,
            CACHE_VARIABLE: str(tmp_path / "cache"), "TMPDIR": str(tmp_path),
            # The interpreter frees little of its memory at its end.
            "ASAN_OPTIONS": "detect_leaks=0",
        },
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )


def test_solves_and_roll_outs_break_no_rule_of_the_language(sanitizers, tmp_path):
    done = run(sanitizers, tmp_path)
    assert done.returncode == 0 and done.stdout.endswith("all done\n"), done.stderr


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_put_into_the_source_is_found(sanitizers, tmp_path, fault):
    done = run(sanitizers, tmp_path, *FAULTS[fault])
    assert done.returncode != 0
    assert "AddressSanitizer" in done.stderr or "runtime error" in done.stderr, done.stderr
