# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Imports between the packages, read from the source code.

``python test/support/import_graph.py`` brings the tables and the drawing in CONTRIBUTING.md up to
date with the code; the difference then shows what a change adds to the imports, or takes away.

A *unit* of a scope is a module or package directly inside it. The scope ``""`` is the
first level: its units are those inside ``sphere_nmpc`` and ``sphere_sim``.
"""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "CONTRIBUTING.md"
TREES = ("sphere_nmpc", "sphere_sim")
SCOPES = ("", "sphere_nmpc.solver", "sphere_nmpc.ros", "sphere_sim.ros")

FLOORS = {
    "sphere_sim": (
        ("cli",),
        ("demo",),
        ("ros",),
        ("viewer", "report", "identification"),
        ("study", "benchmark", "recording"),
        ("evaluation", "scenario"),
        ("world",),
        ("output",),
    ),
    "sphere_nmpc": (
        ("ros",),
        ("control",),
        ("strategy", "estimation"),
        ("floor",),
        ("solver", "settings"),
        ("model", "worker"),
        ("quantities", "process"),
        ("foreign", "reporting"),
        ("errors",),
    ),
}
"""Units of the first level from top to bottom: each may import only from lower floors."""

Graph = dict[str, set[str]]


def sources() -> dict[str, Path]:
    """Return the file of each module; a package has the name of its folder."""
    found = {}
    for tree in TREES:
        for path in sorted((ROOT / tree).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(path: Path) -> Iterator[str]:
    """Yield the full names that a file imports, at its top or inside a function."""
    package = path.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *filter(None, [node.module])))
            yield from (f"{module}.{alias.name}" for alias in node.names)


@cache
def module_graph() -> Graph:
    """Return which modules of this project each module imports."""
    modules = sources()
    return {
        module: {_defining(name, modules) for name in imports_of(path)} - {"", module}
        for module, path in modules.items()
    }


def _defining(name: str, modules: dict[str, Path]) -> str:
    """Return the module of this project that defines an imported name; empty if none does."""
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name


def unit(module: str, scope: str) -> str:
    """Return the unit of a scope to which a module belongs; empty if it is outside of it."""
    level = scope.count(".") + 1 if scope else 1
    parts = module.split(".")
    inside = not scope or module.startswith(f"{scope}.")
    return ".".join(parts[: level + 1]) if inside and len(parts) > level else ""


def units_graph(scope: str) -> Graph:
    """Return which units of a scope each unit imports."""
    graph: Graph = {}
    for module, targets in module_graph().items():
        here = unit(module, scope)
        if here:
            graph.setdefault(here, set()).update(unit(target, scope) for target in targets)
    return {here: targets - {"", here} for here, targets in graph.items()}


def tables() -> str:
    """Return the tables of imports between the units of each scope, in Markdown."""
    parts = []
    for scope in SCOPES:
        graph = units_graph(scope)
        for tree in [scope] if scope else TREES:
            prefixes = [scope] if scope else TREES[: TREES.index(tree) + 1]
            heads = [f"imports from `{prefix}`" for prefix in prefixes]
            parts += ["", "| " + " | ".join(["package", "holds", *heads]) + " |"]
            parts.append("|---" * (2 + len(heads)) + "|")
            for name in sorted(name for name in graph if name.startswith(f"{tree}.")):
                cells = [_names(graph[name], prefix) for prefix in prefixes]
                parts.append(f"| `{name}` | {_first_line(name)} | " + " | ".join(cells) + " |")
    return "\n".join(parts).strip()


def _names(targets: set[str], prefix: str) -> str:
    return ", ".join(sorted(
        target.removeprefix(f"{prefix}.") for target in targets if target.startswith(f"{prefix}.")
    ))  # fmt: skip


def _first_line(module: str) -> str:
    text = ast.get_docstring(ast.parse(sources()[module].read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].replace("``", "`").replace("|", "\\|")


def drawing() -> str:
    """Return the first level as a Mermaid flow chart, without arrows that others imply."""
    graph = units_graph("")
    lines = ["```mermaid", "flowchart TB"]
    for tree, floors in FLOORS.items():
        lines.append(f"  subgraph {tree}")
        for number, floor in enumerate(floors):
            lines.append(f'    subgraph {tree}_{number}[" "]')
            lines += [f"      {tree}.{name}[{name}]" for name in floor]
            lines.append("    end")
        lines.append("  end")
    for here in sorted(graph):
        indirect = {name for target in graph[here] for name in reachable(graph, target)}
        lines += [f"  {here} --> {target}" for target in sorted(graph[here] - indirect)]
    return "\n".join([*lines, "```"])


def reachable(graph: Graph, start: str) -> set[str]:
    """Return all units that `start` imports, itself or through others."""
    found: set[str] = set()
    ahead = set(graph[start])
    while ahead:
        found.add(here := ahead.pop())
        ahead |= graph[here] - found
    return found


def circle(graph: Graph) -> set[str]:
    """Return the units that import themselves through others."""
    return {here for here in graph if here in reachable(graph, here)}


def updated(text: str) -> str:
    """Return the text of CONTRIBUTING.md with the tables and the drawing of now, between marks."""
    for name, content in (("tables", tables()), ("drawing", drawing())):
        begin, end = f"<!-- imports: {name} -->\n", f"<!-- end of {name} -->"
        before, rest = text.split(begin)
        text = f"{before}{begin}{content}\n{end}{rest.split(end)[1]}"
    return text


if __name__ == "__main__":
    DOCUMENT.write_text(updated(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
