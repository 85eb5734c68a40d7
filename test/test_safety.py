# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Safety of the sources: files cannot run code, and no command goes through a shell."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("sphere_nmpc", "sphere_sim", "launch", "bench")
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
ALLOWED = {
    # Pipes between processes of the package, one of which has started the other: they have no name
    # that anyone else could open.
    "sphere_nmpc/worker/channel.py": {"pickle"},
    "bench/documents/momentum_holding.py": {"ProcessPoolExecutor"},
    "bench/documents/strategies_of_robots.py": {"ProcessPoolExecutor"},
    # A cluster of Dask, which the user has started and named with --scheduler.
    "sphere_sim/study/cluster.py": {"distributed"},
}
"""What a file may use all the same."""


def of_call(call: ast.Call) -> Iterator[str]:
    """Yield what is unsafe about a call: itself, or its arguments."""
    name = ast.unparse(call.func)
    first = call.args[0] if call.args else None
    if name in CALLS:
        yield name
    if name.endswith(("import_module", "__import__")) and isinstance(first, ast.Constant):
        yield from {str(first.value).partition(".")[0]} & PICKLING
    for keyword in call.keywords:
        if keyword.arg in ("shell", "allow_pickle") and ast.unparse(keyword.value) != "False":
            yield keyword.arg
    # The third one of numpy.load is allow_pickle.
    if name in ("np.load", "numpy.load") and len(call.args) > 2:
        yield "allow_pickle"


def dangers(source: str) -> set[str]:
    """Return the unsafe imports, names, calls and arguments in a source."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            found |= {alias.name for alias in node.names} & PICKLERS
            modules = [alias.name for alias in node.names]
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else modules
            found |= {module.partition(".")[0] for module in modules} & PICKLING
        elif isinstance(node, ast.Name):
            found |= {node.id} & PICKLERS
        elif isinstance(node, ast.Attribute):
            found |= {node.attr} & PICKLERS
        elif isinstance(node, ast.Call):
            found |= set(of_call(node))
    return found


@pytest.mark.parametrize(
    "source",
    ["import pickle", "from pickle import loads", "import multiprocessing.connection",
     "from concurrent.futures import ProcessPoolExecutor", "frame = pandas.read_pickle(f)",
     "import_module('pickle')", "importlib.import_module('multiprocessing.reduction')",
     "__import__('marshal')", "eval('1')", "import os\nos.system('ls')",
     "subprocess.run('ls', shell=wanted)", "np.load(f, allow_pickle=True)",
     "np.load(f, None, True)"],
)
def test_each_danger_is_found(source: str) -> None:
    assert dangers(source)


def test_what_is_safe_is_not_taken_for_a_danger() -> None:
    assert not dangers("subprocess.run(['ls'], shell=False); np.load(f, allow_pickle=False)")
    assert not dangers("from concurrent.futures import ThreadPoolExecutor; import_module(name)")


def test_no_pickle_but_between_own_processes_no_shell_no_code_from_files() -> None:
    paths = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    found = {str(path.relative_to(ROOT)): dangers(path.read_text("utf-8")) for path in paths}
    assert {file: names for file, names in found.items() if names} == ALLOWED
