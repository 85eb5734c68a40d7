# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sources: licence header, docstrings that read alone, length of files, arithmetic of nodes."""

import ast
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEADER = "# Copyright 2026 sphere_nmpc contributors\n# SPDX-License-Identifier: Apache-2.0\n"
PACKAGE = ("sphere_nmpc", "sphere_sim", "launch")
LONGEST = 400
"""Lines of a file at most."""
FRAGMENT = re.compile(
    r"(It|Its|That|Those|These|They|Their|Of|By|With|Without|From|For|To|As|Also|And|Or)\b"
)
"""Beginning of a text that goes on from what is described rather than naming it."""
NOT_IMPERATIVE = re.compile(r"(\w+(?<!s)s|\w+(?<!Br)ing|The|An?|Whether|What|Which|How|When)\b")
OBJECT_UNNAMED = re.compile(r"\w+ (it|them|these|those|they)\b")


def sources(*folders: str) -> list[tuple[str, str]]:
    """Return names and texts of the Python files in folders."""
    return [
        (path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))
        for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))
    ]


def constants(tree: ast.AST) -> Iterator[str]:
    """Yield the docstrings of constants and attributes."""
    for block in ast.walk(tree):
        body = getattr(block, "body", None)
        for one, after in itertools.pairwise(body if isinstance(body, list) else []):
            if isinstance(one, ast.Assign | ast.AnnAssign) and isinstance(after, ast.Expr):
                text = getattr(after.value, "value", None)
                if isinstance(text, str):
                    yield " ".join(text.split())


def described_badly(source: str) -> Iterator[str]:
    """Yield first lines of docstrings that do not read alone."""
    tree = ast.parse(source)
    yield from filter(FRAGMENT.match, constants(tree))
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        first, *more = (ast.get_docstring(node) or "Return.").splitlines()
        decorators = " ".join(map(ast.unparse, getattr(node, "decorator_list", ())))
        is_function = isinstance(node, ast.FunctionDef) and "property" not in decorators
        if FRAGMENT.match(first) or (more and more[0]) or re.search(r"[^.]\. [A-Z]", first) or (
            is_function and (NOT_IMPERATIVE.match(first) or OBJECT_UNNAMED.match(first))
        ):
            yield first


def test_sources_carry_the_licence_header_and_texts_of_constants_are_sentences() -> None:
    wrong = []
    for name, text in sources(*PACKAGE, "test", "bench", "examples"):
        if not text.removeprefix("#!/usr/bin/env python3\n").startswith(HEADER):
            wrong.append(f"{name}: the header")
        wrong += [
            f"{name}: {one}" for one in constants(ast.parse(text))
            if not (one[0].isupper() and re.search(r"[^.]\.$", one))
        ]
    assert not wrong


def test_first_lines_of_docstrings_read_alone() -> None:
    """Each is one sentence, that of a function an order, and names what is described."""
    wrong = [f"{name}: {one}" for name, text in sources(*PACKAGE) for one in described_badly(text)]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("source", "is_wrong"),
    [
        ('A = 1\n"""Largest speed [m/s]."""', False), ('A = 1\n"""Of the shell [m/s]."""', True),
        ('def f():\n    """Return the speed."""', False), ('def f():\n    """The speed."""', True),
        ('def f():\n    """Returns the speed."""', True),
        ('def f():\n    """Pass a speed on."""', False),
        ('def f():\n    """Return it with another unit."""', True),
        ('def f():\n    """Return the speed. Negative ones count."""', True),
        ('def f():\n    """Return the speed\n    of the shell."""', True),
        ('@property\ndef f():\n    """Whether it moves."""', False),
        ('@property\ndef f():\n    """Its speed [m/s]."""', True),
        ('"""Those of the shell."""', True),
    ],
)
def test_text_that_does_not_read_alone_is_found(source: str, is_wrong: bool) -> None:
    assert bool([*described_badly(source)]) is is_wrong


def test_no_file_is_longer_than_four_hundred_lines_but_those_that_are_to_be_shortened() -> None:
    lengths = {
        name: text.count("\n") for name, text in sources("sphere_nmpc", "sphere_sim", "test")
    }
    assert {name: n for name, n in lengths.items() if n > LONGEST} == {}


def products(source: str) -> Iterator[str]:
    """Yield products, quotients and powers in classes of nodes, but conversions of time."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef) and any(
            ast.unparse(base).endswith("Node") for base in node.bases
        ):
            for one in ast.walk(node):
                sums = ast.Add | ast.Sub | ast.BitOr | ast.BitAnd
                if isinstance(one, ast.BinOp | ast.AugAssign) and not isinstance(one.op, sums):
                    text = ast.unparse(one)
                    if not re.search(r"\bNANOSECONDS\b|\b1e-09\b", text):
                        yield text


def test_nodes_hold_no_arithmetic() -> None:
    """They add and subtract times and counts; what is more is a function of the core."""
    found = [
        f"{name}: {one}" for name, text in sources("sphere_nmpc/ros", "sphere_sim/ros")
        if name.endswith("/node.py") for one in products(text)
    ]
    assert not found
    node = "class A(GuardedNode):\n    def f(self):\n        return {}"
    assert not [*products(node.format("self.now - 2 + NANOSECONDS * self.period"))]
    for wrong in ("0.5 * self.speed", "self.a @ self.b", "self.a ** 2", "self.a % 3"):
        assert [*products(node.format(wrong))] == [wrong]
