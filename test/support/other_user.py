# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands that run as another user, who may have neither a home nor a name."""

import os
import shutil
import subprocess
import sys
from functools import cache

import pytest

_READING = ("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search")
"""Permission to read everywhere: interpreter and package may lie below a folder of root alone."""


@cache
def as_user(user: int) -> tuple[str, ...]:
    """Return the beginning of a command that runs as a user; skip the test where it cannot."""
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        pytest.skip("needs root and setpriv, of util-linux, to become another user")
    become = ("setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups")
    for command in (become, (*become, *_READING)):
        use = [*command, sys.executable, "-c", "import sphere_nmpc.solver"]
        if subprocess.run(use, capture_output=True, check=False).returncode == 0:
            return command
    pytest.skip("no other user can read this Python, and root may not grant it here")
