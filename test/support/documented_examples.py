# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Examples, and what the tutorial prints of them."""

import re
import subprocess

from document_commands import FENCE, ROOT
from patience import PATIENCE

from sphere_nmpc.process.child import python_command

EXAMPLES = ROOT / "examples"
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]\d+)?")


def section(name: str) -> str:
    """Return the section of the tutorial whose heading begins with the name of an example."""
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    found = re.search(rf"^### `{re.escape(name)}`.*?(?=^##|\Z)", text, re.MULTILINE | re.DOTALL)
    assert found, f"docs/tutorial.md has no section of {name}"
    return found[0]


def printed(name: str, language: str) -> list[str]:
    """Return what is printed of an example in blocks of a language."""
    return [block for kind, block in FENCE.findall(section(name)) if kind == language]


def forms(text: str) -> set[str]:
    """Return the lines of an output, each once, with # for each number and single spaces."""
    return {NUMBER.sub("#", " ".join(line.split())) for line in text.splitlines()}


def example_command(name: str, *arguments: str) -> list[str]:
    """Return the command line of an example, which ends with this process."""
    return python_command(
        f"import runpy; sys.argv[0] = {name!r}; "
        f"runpy.run_path({str(EXAMPLES / name)!r}, run_name='__main__')",
        *arguments,
    )


def run_example(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run an example to its end."""
    command = example_command(name, *arguments)
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
