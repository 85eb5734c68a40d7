# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command lines in the documents."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    path for folder in (".", "docs", "msg_docs", "bench") for path in (ROOT / folder).glob("*.md")
)
FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:(?<=\n\n)|\A)(?:(?: {4}.*)?\n)+", re.MULTILINE)
SPAN = re.compile(r"`([^`]+)`")
BEGINS_A_COMMAND = re.compile(
    r"(?:ros2|sphere_nmpc|make|python)\s+[\w-]|--ros-args\s|-[pr]\s|[\w.]+:=\S"
)
"""Beginning of a command as inline code, which mostly is not a command."""
SUBSTITUTION = re.compile(r"\$\(([^()]*)\)")
SHELLS = ("", "sh", "bash", "console")
NO_COMMAND = re.compile(r"\(|\S+ = ")
"""Beginning of a formula, which is indented like a command."""
BEFORE_A_COMMAND = re.compile(r"do|sudo|[A-Z_]+=\S*")


class Command(NamedTuple):
    """Command in a document."""

    document: str
    words: tuple[str, ...]
    inline: bool
    """Whether it is in running text, where options may be left out."""

    def __str__(self) -> str:
        return f"{self.document}: {' '.join(self.words)}"


def all_commands() -> list[Command]:
    """Return the commands of all documents, each once, in order."""
    found = {
        command: None
        for path in DOCUMENTS
        for command in commands(path.relative_to(ROOT).as_posix(), path.read_text("utf-8"))
    }
    return list(found)


def commands(document: str, text: str) -> Iterator[Command]:
    """Yield the commands in code blocks, and in inline code that begins like a command."""
    blocks = [block for language, block in FENCE.findall(text) if language in SHELLS]
    text = FENCE.sub("", text)
    blocks += INDENTED.findall(text)
    for block in blocks:
        for line in re.sub(r"\\\n\s*", " ", block).splitlines():
            if not NO_COMMAND.match(line.strip()):
                for words in split(line):
                    yield Command(document, words, False)
    for span in SPAN.findall(INDENTED.sub("", text)):
        if BEGINS_A_COMMAND.match(span):
            for words in split(" ".join(span.replace("\\\n", " ").split())):
                yield Command(document, words, True)


def split(line: str) -> Iterator[tuple[str, ...]]:
    """Yield the simple commands of a shell line, without keywords and assignments before them."""
    for inner in SUBSTITUTION.findall(line):
        yield from split(inner)
    lexer = shlex.shlex(SUBSTITUTION.sub("OUTPUT", line), posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words: list[str] = []
    for word in [*lexer, ";"]:
        if set(word) <= set("();<>|&"):
            if words:
                yield tuple(words)
            words = []
        elif words or not BEFORE_A_COMMAND.fullmatch(word):
            words.append(word)
