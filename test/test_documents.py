# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""References in the documents: files, headings, make targets and scripts exist."""

import re
from pathlib import Path

from document_commands import DOCUMENTS, ROOT

LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")


def anchors(document: Path) -> set[str]:
    """Return the anchors of the headings, as they are made on web pages."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def test_targets_of_links_exist() -> None:
    broken = [
        f"{document.name}: {link}" for document in DOCUMENTS
        for link in map("".join, LINK.findall(document.read_text("utf-8")))
        if not re.match(r"[a-z]+:", link) and not target_exists(document, link)
    ]
    assert not broken


def target_exists(document: Path, link: str) -> bool:
    file, _, heading = link.partition("#")
    target = (document.parent / file).resolve() if file else document
    return target.exists() and (not heading or heading in anchors(target))


def mentioned(pattern: str) -> dict[str, set[str]]:
    """Return what a pattern finds in all documents, with the documents in which it is."""
    found: dict[str, set[str]] = {}
    for document in DOCUMENTS:
        for name in re.findall(pattern, document.read_text(encoding="utf-8"), re.MULTILINE):
            found.setdefault(name, set()).add(document.name)
    return found


def test_make_targets_in_documents_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    used = mentioned(r"(?:`|^)make ([a-z-]+)")
    assert {"demo", "test"} <= used.keys()
    assert not {target: used[target] for target in used.keys() - targets}


def test_scripts_in_documents_exist() -> None:
    used = mentioned(r"python (\w+/[\w/]+\.py)")
    assert "bench/control_rate.py" in used
    assert not {script: used[script] for script in used if not (ROOT / script).exists()}
