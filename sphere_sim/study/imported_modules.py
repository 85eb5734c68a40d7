# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Modules of the project that a module imports, directly or indirectly, found in its source."""

import ast
from collections.abc import Collection, Iterator
from pathlib import Path

import sphere_nmpc
import sphere_sim

_ROOTS = {
    package.__name__: Path(str(package.__file__)).parent for package in (sphere_nmpc, sphere_sim)
}


def imported_modules(*names: str, not_by_name: Collection[str] = ()) -> dict[str, Path]:
    """Return the source files of some modules and of all that these import, by module.

    Imports within functions count too, imports for type checking do not. A string that is the
    name of a module, alone or before a colon, counts as an import, because modules that are loaded
    when they are needed are named so.

    Parameters
    ----------
    *names : str
        Full names of modules.
    not_by_name : collection of str
        Modules that a string does not import.
    """
    found: dict[str, Path] = {}
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        path = _source(name)
        if path is None or name in found:
            continue
        found[name] = path
        if "." in name:
            waiting.append(name.rpartition(".")[0])  # a package is imported before its modules
        waiting += _imports(ast.parse(path.read_bytes()), not_by_name)
    return found


def _source(name: str) -> Path | None:
    """Return the file of a module of this package, None for any other name."""
    root, *inner = name.split(".")
    if root not in _ROOTS or not all(part.isidentifier() for part in inner):
        return None
    place = _ROOTS[root].joinpath(*inner)
    candidates = (place.with_suffix(".py"), place / "__init__.py")
    return next((path for path in candidates if path.is_file()), None)


def _imports(node: ast.AST, not_by_name: Collection[str]) -> Iterator[str]:
    """Yield all names that may be imported modules."""
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module is not None:
        yield node.module
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        module = node.value.partition(":")[0]
        if module not in not_by_name:
            yield module
    for child in ast.iter_child_nodes(node):
        yield from _imports(child, not_by_name)
