# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Configuration of Sphinx, which makes pages of the documents as they are on a forge.

    sphinx-build -W --keep-going -c docs . build/pages

The source folder is that of the package, so that relative links lead to the same files in both.
"""

import re
import shlex
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from sphinx import addnodes
from sphinx.ext.napoleon import NumpyDocstring
from sphinx.util import logging

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))


class Vector:
    """Array of floats in signatures, in place of what its annotation is made of."""

    def __class_getitem__(cls, kind: type) -> type:
        return cls if kind is np.float64 else np.ndarray


# Before the package is imported, whose annotations are made of these two.
np.typing.NDArray = Vector
np.typing.ArrayLike = type("ArrayLike", (), {"__module__": "numpy.typing"})

from sphere_nmpc.quantities import quantities  # noqa: E402

PACKAGE = ElementTree.parse(ROOT / "package.xml")

project = "sphere_nmpc"
author = "sphere_nmpc contributors"
project_copyright = f"2026 {author}"
release = PACKAGE.findtext("version", "")

nitpicky = True
extensions = ["myst_parser", "sphinx-mathjax-offline", "sphinxcontrib.mermaid"]
root_doc = "README"
include_patterns = ["*.md", "docs/*.md", "docs/api/*.md", "msg_docs/*.md"]
include_patterns += ["bench/README.md", ".github/[CS]*.md"]

# What the documents use of the Markdown of forges.
myst_enable_extensions = ["dollarmath", "strikethrough"]
myst_fence_as_directive = ["mermaid"]
# The drawing is made here: pages need nothing from another host.
mermaid_output_format = "svg"
mermaid_cmd = shlex.join([sys.executable, "-m", "mermaidx"])
myst_heading_anchors = 6
highlight_language = "text"
nitpick_ignore_regex = [
    # Documents of Python, NumPy and CasADi are on other hosts.
    ("py:class", r"(collections|pathlib|numpy|casadi)\..+"),
    ("py:class", r"sphere_.*\.(S|T|_Kind)"),  # type variables
    # Parts that public names hand on to each other: no example makes or reads them.
    ("py:class", r"sphere_.*\.(Floor(Settings)?|Motion|RobotUnits|RunRecord|Walls|Workers?)"),
]
suppress_warnings = ["myst.strikethrough"]  # "only in HTML", which is what is made

# The pages of the API. One annotation needs CasADi, which takes 150 MB.
extensions += ["sphinx.ext.autodoc", "sphinx.ext.napoleon"]
autodoc_mock_imports = ["casadi"]
autodoc_default_options = {"members": True, "member-order": "bysource"}
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"
# Shapes are no types: they are not looked up.
napoleon_use_param = napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]
# A colon in the first line of a property does not end a type.
napoleon_google_docstring = False
NumpyDocstring._parse_attribute_docstring = NumpyDocstring._consume_to_end
default_role = "py:obj"

html_theme = "furo"
html_title = f"{project} {release}"
html_copy_source = False

CONTENTS = """
```{{toctree}}
:hidden:
:glob:

{}
```
"""
"""Contents in the order of links, and after them what is not linked to."""


def add_contents(app: Any, document: str, source: list[str]) -> None:
    """Add the contents, which a forge does not need, to the first page and to that of the API."""
    if document == root_doc:
        _, _, table = source[0].partition("\n## Documents\n")
        links = re.findall(r"\]\(([\w/]+)\.md\)", table.partition("\n## ")[0])
        links += ["docs/*", "bench/README", ".github/[CS]*"]
        source[0] += CONTENTS.format("\n".join(links))
    elif document == "docs/api":
        links = re.findall(r"\]\((api/\w+)\.md\)", source[0])
        source[0] += CONTENTS.format("\n".join(links))


def add_quantities(
    app: Any, what: str, name: str, found: Any, options: Any, lines: list[str]
) -> None:
    """Add the quantities of a dataclass to its text."""
    if what == "class" and (fields := getattr(found, "__dataclass_fields__", None)):
        about = quantities(found)
        lines += ["Attributes", "----------"] if about else []
        for one, said in about.items():
            default = fields[one].default
            limits = " or ".join(said.choices)
            if said.maximum is not None:
                limits = f"{said.minimum:g} to {said.maximum:g} [{said.unit}]"
            lines += [
                f"{one} : {type(default).__name__}, default {default}",
                f"    {said.description}{limits and '; '}{limits}.",
            ]


def link_names(app: Any, env: Any, node: Any, shown: Any) -> Any:
    """Leave names in single backticks that have no page, such as those of arguments."""
    return shown if node["reftype"] == "obj" else None


def leave_out_modules(app: Any, document: Any) -> None:
    """Leave out the modules of what is not public, which are not to be imported from."""
    for node in [*document.findall(addnodes.desc_addname)]:
        if node.astext().count(".") > 1:
            node.parent.remove(node)


def add_index(app: Any, failure: Exception | None) -> None:
    """Let the address of the folder lead to the first page."""
    if not failure and app.builder.format == "html":
        page = f'<!doctype html><meta http-equiv="refresh" content="0; url={root_doc}.html">\n'
        (Path(app.outdir) / "index.html").write_text(page, encoding="utf-8")


def check_hosts(app: Any, failure: Exception | None) -> None:
    """Warn of each page that loads a script or a style from another host."""
    loaded = re.compile(r'<(?:script|link)\b[^>]*(?:src|href)="(https?:[^"]+)"')
    for page in Path(app.outdir).rglob("*.html"):
        for found in loaded.finditer(page.read_text(encoding="utf-8")):
            logging.getLogger(__name__).warning("%s loads %s", page.name, found[1])


def setup(app: Any) -> None:
    """Connect the functions above to the events of Sphinx."""
    app.connect("source-read", add_contents)
    app.connect("autodoc-process-docstring", add_quantities, priority=400)  # before Napoleon
    app.connect("missing-reference", link_names)
    app.connect("doctree-read", leave_out_modules)
    app.connect("build-finished", add_index)
    app.connect("build-finished", check_hosts)
