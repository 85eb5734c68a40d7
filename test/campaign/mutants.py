# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Mutation test of the core: small changes of the code, each of which some test should notice.

``mutants.py draw LIST`` draws mutants of the solver in C, the strategies, the control loop and the
estimation; ``mutants.py run LIST RESULTS --tests FOLDER`` applies each to a copy of the tree, and
runs the tests in FOLDER, by default those of this tree. So the same list can be run with the tests
before and after a change of them. A mutant that is in RESULTS already is not run again.
"""

import argparse
import ast
import itertools
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
ROOMS = {
    room: f"sphere_nmpc/{folder}" for room, folder in (
        ("solver", "solver/native"), ("strategy", "strategy"), ("control", "control"),
        ("estimation", "estimation"),
    )
}
"""Folder of the code of each room; its tests are in the folder of that name in test/unit."""
TESTS = [*(f"test/unit/{room}" for room in (*ROOMS, "model", "floor")), "test/loops"]
SWAPPED = {
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "is not": "is", "is":
    "is not", "+": "-", "-": "+", "*": "/", "/": "*", "and": "or", "or": "and", "&&": "||", "||":
    "&&", "+=": "-=", "-=": "+=", "True": "False", "False": "True",
}
C_TOKEN = re.compile(
    r"(?<= )(<=?|>=?|[=!]=|[-+*/]|&&|\|\||[-+]=)(?= )|(?<![\w.])\d+\.\d+(?![\w.])"
)
TIME_LIMIT = 400.0
"""Time that the tests of one mutant may take [s], beyond which it counts as caught."""


class Mutant(NamedTuple):
    """A change of one token, found again by its line wherever that has moved in its file."""

    room: str
    file: str
    line: str
    occurrence: int
    column: int
    old: str
    new: str


def _changed(token: str) -> str:
    if token in SWAPPED:
        return SWAPPED[token]
    if float(token) == 0.0:
        return "1.0" if "." in token else "1"
    return f"({token} * 1.5)" if "." in token else f"({token} + 1)"


def _in_python(text: str) -> Iterator[tuple[int, int, str, str]]:
    """Return line, column, old and new token of operators, numbers and results."""
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        operands: list[ast.expr] = []
        if isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
        elif isinstance(node, ast.BoolOp):
            operands = node.values
        elif isinstance(node, ast.BinOp):
            operands = [node.left, node.right]
        elif isinstance(node, ast.Constant) and type(node.value) in (bool, int, float):
            old = ast.get_source_segment(text, node) or ""
            if old in SWAPPED or re.fullmatch(r"[\d.]+(e[-+]?\d+)?", old):
                yield node.lineno - 1, node.col_offset, old, _changed(old)
        elif isinstance(node, ast.Return) and ast.unparse(node) not in ("return", "return None"):
            yield node.lineno - 1, node.col_offset, "return ", "return None and "
        for left, right in itertools.pairwise(operands):
            row = (left.end_lineno or 0) - 1
            start = left.end_col_offset or 0
            end = right.col_offset if right.lineno - 1 == row else len(lines[row])
            found = re.search(r"is not|[<>=!]=|[<>*/+-]|\b(is|and|or)\b", lines[row][start:end])
            if found and "**" not in lines[row][start:end] and "//" not in lines[row][start:end]:
                yield row, start + found.start(), found[0], SWAPPED[found[0]]


def _in_c(text: str) -> Iterator[tuple[int, int, str, str]]:
    without = re.sub(r"/\*.*?\*/", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.DOTALL)
    for row, line in enumerate(without.splitlines()):
        for found in C_TOKEN.finditer("" if line.startswith("#") else line):
            if found[0] != "*" or not re.search(r"(double|problem)$", line[: found.start() - 1]):
                yield row, found.start(), found[0], _changed(found[0])


def drawn(seed: int, count: int) -> list[Mutant]:
    """Return mutants of this tree, as many of each room and by turns."""
    rng, found = random.Random(seed), list[list[Mutant]]()
    for k, (room, folder) in enumerate(ROOMS.items()):
        sites = []
        suffixes = (".c", ".h") if room == "solver" else (".py",)
        for path in sorted(p for p in (ROOT / folder).rglob("*") if p.suffix in suffixes):
            text = path.read_text()
            lines = text.splitlines()
            for row, column, old, new in (_in_python if path.suffix == ".py" else _in_c)(text):
                line = lines[row].strip()
                before = sum(other.strip() == line for other in lines[:row])
                column -= len(lines[row]) - len(lines[row].lstrip())
                name = str(path.relative_to(ROOT))
                sites.append(Mutant(room, name, line, before, column, old, new))
        found.append(rng.sample(sites, count // len(ROOMS) + (k < count % len(ROOMS))))
    return [each for turn in itertools.zip_longest(*found) for each in turn if each]


def _mutated(text: str, mutant: Mutant) -> str:
    lines = text.splitlines()
    row = [k for k, line in enumerate(lines) if line.strip() == mutant.line][mutant.occurrence]
    at = len(lines[row]) - len(lines[row].lstrip()) + mutant.column
    assert lines[row][at:].startswith(mutant.old)
    lines[row] = lines[row][:at] + mutant.new + lines[row][at + len(mutant.old) :]
    return "\n".join(lines) + "\n"


def _copied(into: Path, tests: Path) -> None:
    """Copy the package of this tree and the tests of another one."""
    left_out = shutil.ignore_patterns("__pycache__")
    for path in sorted(ROOT.iterdir()):
        if path.name == "test":
            shutil.copytree(tests / "test", into / "test", ignore=left_out)
        elif path.is_dir() and path.name[0] not in "._":
            shutil.copytree(path, into / path.name, ignore=left_out)
        elif path.is_file():
            shutil.copy(path, into)


def tried(mutant: Mutant, tree: Path) -> dict[str, object]:
    """Run the tests of a tree with a mutant, those of its room first, up to the first failure."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    path, began = tree / mutant.file, time.monotonic()
    text = path.read_text()
    path.write_text(_mutated(text, mutant))
    libraries = {p: p.read_bytes() for p in (tree / ROOMS["solver"]).glob("*.so")}
    tests = sorted(TESTS, key=lambda folder: folder != f"test/unit/{mutant.room}")
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider",
               "--no-header", "-r", "N", "--tb=no", *tests]
    try:
        if mutant.room == "solver":
            for library in libraries:
                library.unlink()
            build = [sys.executable, "setup.py", "-q", "build_ext", "--inplace"]
            subprocess.run(build, cwd=tree, env=environment, check=True, capture_output=True)
            if not all(library.exists() for library in libraries):
                raise subprocess.CalledProcessError(1, build)
        done = subprocess.run(
            command, cwd=tree, env=environment, timeout=TIME_LIMIT, capture_output=True, text=True,
        )
        caught, words = done.returncode != 0, done.stdout.splitlines()[-1:]
    except subprocess.TimeoutExpired:
        caught, words = True, ["time limit"]
    except subprocess.CalledProcessError:
        caught, words = True, ["not compiled"]
    path.write_text(text)
    for library, content in libraries.items():
        library.write_bytes(content)
    return {"caught": caught, "seconds": round(time.monotonic() - began, 1), "words": words}


def main() -> None:
    """Draw mutants, or run the tests with each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=["draw", "run"])
    parser.add_argument("list", type=Path)
    parser.add_argument("results", type=Path, nargs="?")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--tests", type=Path, default=ROOT)
    arguments = parser.parse_args()
    if arguments.action == "draw":
        mutants = drawn(arguments.seed, arguments.count)
        arguments.list.write_text(json.dumps([m._asdict() for m in mutants], indent=1))
        return
    results = json.loads(arguments.results.read_text()) if arguments.results.exists() else {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        _copied(Path(folder), arguments.tests)
        for k, entry in enumerate(json.loads(arguments.list.read_text())):
            if str(k) not in results:
                mutant = Mutant(**entry)
                results[str(k)] = tried(mutant, Path(folder))
                arguments.results.write_text(json.dumps(results, indent=1))
                print(k, mutant.file, mutant.line, "->", mutant.new, results[str(k)], flush=True)


if __name__ == "__main__":
    main()
