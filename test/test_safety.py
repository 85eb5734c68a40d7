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
PICKLING = {
    "_pickle", "cPickle", "cloudpickle", "copyreg", "dask", "dill", "distributed", "joblib",
    "marshal", "multiprocessing", "pickle", "pickletools", "shelve",
}
"""Modules that pickle, or keep code in files; those that do so between processes included."""
PICKLERS = {
    "ForkingPickler", "Pickler", "ProcessPoolExecutor", "Unpickler", "read_pickle", "to_pickle",
}
"""The same as names of other modules."""
CALLS = {"eval", "exec", "os.system", "os.popen", "subprocess.getoutput", "yaml.load",
         "yaml.unsafe_load", "yaml.full_load"}
UNSAFE_UNLESS_FALSE = {"shell", "allow_pickle"}
"""Keyword arguments."""

ALLOWED = {
    # Pipes between processes of the package, one of which has started the other: they have no name
    # that anyone else could open.
    "sphere_nmpc/child.py": {"pickle"},
    "bench/documents/momentum_holding.py": {"ProcessPoolExecutor"},
    "bench/documents/strategies_of_robots.py": {"ProcessPoolExecutor"},
    # A cluster of Dask, which the user has started and named with --scheduler.
    "sphere_sim/study/workers.py": {"distributed"},
}
"""What a file may use all the same."""


def imported(node: ast.AST) -> list[str]:
    """Return the names of the modules that a node imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [node.module or ""]
    is_call = isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
        ("import_module", "__import__")
    )
    if is_call and node.args and isinstance(node.args[0], ast.Constant):
        return [str(node.args[0].value)]
    return []


def names_in(node: ast.AST) -> list[str]:
    """Return the names that a node itself uses or imports."""
    if isinstance(node, ast.Name):
        return [node.id]
    if isinstance(node, ast.Attribute):
        return [node.attr]
    return [alias.name for alias in node.names] if isinstance(node, ast.ImportFrom) else []


def unsafe_arguments(call: ast.Call) -> Iterator[str]:
    """Yield the unsafe arguments of a call."""
    for keyword in call.keywords:
        value = ast.unparse(keyword.value)
        if keyword.arg in UNSAFE_UNLESS_FALSE and value != "False":
            yield f"{keyword.arg}={value}"
    # The third one of numpy.load is allow_pickle.
    if ast.unparse(call.func) in ("np.load", "numpy.load") and len(call.args) > 2:
        yield "allow_pickle"


def dangers(source: str) -> Iterator[tuple[str, int]]:
    """Yield unsafe imports, names, calls and arguments in a source, with their lines."""
    for node in ast.walk(ast.parse(source)):
        found = {name.partition(".")[0] for name in imported(node)} & PICKLING
        found |= set(names_in(node)) & PICKLERS
        if isinstance(node, ast.Call):
            # ruamel's loader of the same name is safe where it is made with typ="safe".
            found |= {ast.unparse(node.func)} & CALLS
            found |= set(unsafe_arguments(node))
        yield from ((name, getattr(node, "lineno", 0)) for name in sorted(found))


@pytest.mark.parametrize(
    "source",
    ["import pickle", "from pickle import loads", "import _pickle", "import marshal as m",
     "import shelve", "from multiprocessing.reduction import ForkingPickler",
     "from multiprocessing import Pipe", "import multiprocessing.connection", "import dill",
     "from concurrent.futures import ProcessPoolExecutor", "frame = pandas.read_pickle(f)",
     "import concurrent.futures as f\nf.ProcessPoolExecutor()", "import_module('pickle')",
     "importlib.import_module('multiprocessing.reduction')", "__import__('marshal')",
     "eval('1')", "import os\nos.system('ls')",
     "import subprocess\nsubprocess.run('ls', shell=True)",
     "subprocess.run('ls', shell=wanted)", "np.load(f, allow_pickle=True)",
     "np.load(f, None, True)"],
)
def test_each_danger_is_found(source: str) -> None:
    assert list(dangers(source))


@pytest.mark.parametrize(
    "source",
    ["subprocess.run(['ls'], shell=False)", "np.load(f, allow_pickle=False)", "np.load(f)",
     "from concurrent.futures import ThreadPoolExecutor", "import_module(name)"],
)
def test_what_is_safe_is_not_taken_for_a_danger(source: str) -> None:
    assert not list(dangers(source))


def test_no_pickle_but_between_own_processes_no_shell_no_code_from_files() -> None:
    found: dict[str, dict[str, list[int]]] = {}
    for path in FILES:
        for name, line in dangers(path.read_text(encoding="utf-8")):
            found.setdefault(str(path.relative_to(ROOT)), {}).setdefault(name, []).append(line)
    # Lines of what is not allowed; then what is allowed and not used any more.
    surplus = {
        file: left for file, names in found.items()
        if (left := {name: at for name, at in names.items() if name not in ALLOWED.get(file, ())})
    }
    assert surplus == {}
    assert {file: set(names) for file, names in found.items()} == ALLOWED
