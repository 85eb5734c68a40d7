# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Safety of the sources: files cannot run code, and no command goes through a shell."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(
    path for folder in ("sphere_nmpc", "sphere_sim", "launch", "bench")
    for path in (ROOT / folder).rglob("*.py")
)
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib"}
CALLS = {"eval", "exec", "os.system", "os.popen", "subprocess.getoutput", "yaml.load",
         "yaml.unsafe_load", "yaml.full_load"}


def dangers(source: str) -> Iterator[str]:
    """Yield unsafe imports and calls in a source, with their lines."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names = {(node.module or "").partition(".")[0]}
        else:
            names = set()
        yield from (f"line {node.lineno}: {name}" for name in names & MODULES)
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        # ruamel's loader of the same name is safe where it is made with typ="safe".
        if called in CALLS:
            yield f"line {node.lineno}: {called}"
        for keyword in node.keywords:
            value = ast.unparse(keyword.value)
            if (keyword.arg, value) in (("shell", "True"), ("allow_pickle", "True")):
                yield f"line {node.lineno}: {keyword.arg}={value}"


@pytest.mark.parametrize(
    "source",
    ["import pickle", "from pickle import loads", "eval('1')", "import os\nos.system('ls')",
     "import subprocess\nsubprocess.run('ls', shell=True)", "np.load(f, allow_pickle=True)"],
)
def test_each_danger_is_found(source) -> None:
    assert list(dangers(source))


def test_no_pickle_no_shell_no_code_from_files() -> None:
    found = {
        str(path.relative_to(ROOT)): list(dangers(path.read_text(encoding="utf-8")))
        for path in FILES
    }
    assert {name: lines for name, lines in found.items() if lines} == {}
