# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""References in the documents: files, headings, make targets and scripts exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "msg_docs").glob("*.md"),
     *(ROOT / "bench").glob("*.md")]
)
LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(document: Path) -> set[str]:
    """Return the anchors of the headings, as they are made on web pages."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_targets_of_links_exist(document: Path) -> None:
    for found in LINK.findall(document.read_text(encoding="utf-8")):
        link = found[0] or found[1]
        if re.match(r"[a-z]+:", link):
            continue
        file, _, heading = link.partition("#")
        target = (document.parent / file).resolve() if file else document
        assert target.exists(), f"{link} in {document.name}"
        if heading:
            assert heading in anchors(target), f"{link} in {document.name}"


def test_make_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        for target in re.findall(r"(?:`|^)make ([a-z-]+)", text, re.MULTILINE):
            assert target in targets, f"make {target} in {document.name}"


def test_scripts_in_documents_exist() -> None:
    for document in DOCUMENTS:
        for script in re.findall(r"python (\w+/[\w/]+\.py)", document.read_text(encoding="utf-8")):
            assert (ROOT / script).exists(), f"{script} in {document.name}"
