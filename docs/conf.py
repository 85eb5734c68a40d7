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

from sphinx.util import logging

ROOT = Path(__file__).parents[1]
PACKAGE = ElementTree.parse(ROOT / "package.xml")

project = "sphere_nmpc"
author = "sphere_nmpc contributors"
project_copyright = f"2026 {author}"
release = PACKAGE.findtext("version", "")

nitpicky = True
extensions = ["myst_parser", "sphinx-mathjax-offline", "sphinxcontrib.mermaid"]
root_doc = "README"
include_patterns = ["*.md", "docs/*.md", "msg_docs/*.md", "bench/README.md"]

# What the documents use of the Markdown of forges.
myst_enable_extensions = ["dollarmath", "strikethrough"]
myst_fence_as_directive = ["mermaid"]
# The drawing is made here: pages need nothing from another host.
mermaid_output_format = "svg"
mermaid_cmd = shlex.join([sys.executable, "-m", "mermaidx"])
myst_heading_anchors = 6
highlight_language = "text"
suppress_warnings = ["myst.strikethrough"]  # "only in HTML", which is what is made

html_theme = "furo"
html_title = f"{project} {release}"
html_copy_source = False

CONTENTS = """
```{{toctree}}
:hidden:
:glob:

{listed}
docs/*
bench/README
```
"""
"""Contents in the order of the links in the README, and after them what it does not link to."""


def add_contents(app: Any, document: str, source: list[str]) -> None:
    """Add the contents, which a forge does not need, to the first page."""
    if document == root_doc:
        _, _, table = source[0].partition("\n## Documents\n")
        links = re.findall(r"\]\(([\w/]+)\.md\)", table.partition("\n## ")[0])
        source[0] += CONTENTS.format(listed="\n".join(links))


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
    app.connect("build-finished", add_index)
    app.connect("build-finished", check_hosts)
