# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the documents refer to exists: files, headings, verbs, their options, make targets."""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from sphere_sim.cli.main import VERBS

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "msg_docs").glob("*.md"),
     *(ROOT / "bench").glob("*.md")]
)
LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")
CALL = re.compile(r"sphere_nmpc ([a-z]\w+)((?:[^`\n]|\\\n)*)")
OPTION = re.compile(r"(?<=\s)(--[a-z][a-z-]*)")


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(document: Path) -> set[str]:
    """Return the anchors of the headings, as they are made on web pages."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@cache
def help_of(verb: str) -> str:
    code = "import sys; from sphere_sim.cli.main import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, verb, "--help"], capture_output=True, text=True,
        timeout=120, check=False,
    )
    return done.stdout + done.stderr


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_links_lead_somewhere(document: Path) -> None:
    for found in LINK.findall(document.read_text(encoding="utf-8")):
        link = found[0] or found[1]
        if re.match(r"[a-z]+:", link):
            continue
        file, _, heading = link.partition("#")
        target = (document.parent / file).resolve() if file else document
        assert target.exists(), f"{link} in {document.name}"
        if heading:
            assert heading in anchors(target), f"{link} in {document.name}"


def calls() -> list[tuple[str, str, str]]:
    """Return document, verb and option of all command lines."""
    found = set()
    for document in DOCUMENTS:
        for verb, rest in CALL.findall(document.read_text(encoding="utf-8")):
            if verb in VERBS:
                # What follows --ros-args, a comment or a pipe is not the verb's own.
                own = re.split(r"--ros-args| #|\|\s", rest)[0]
                found.update((named(document), verb, o) for o in OPTION.findall(own))
    return sorted(found)


@pytest.mark.parametrize(("document", "verb", "option"), calls(), ids="-".join)
def test_options_are_known_to_their_verb(document: str, verb: str, option: str) -> None:
    if verb in ("simulator", "controller", "recorder"):
        pytest.skip("takes ROS arguments only")
    told = help_of(verb)
    if "is not installed" in told or "there is no" in told:
        pytest.skip(told)
    assert re.search(rf"(?<![\w-]){option}(?![\w-])", told), f"{verb} has no {option}: {document}"


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
