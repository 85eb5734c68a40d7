# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Topics and services of the nodes, as the tables of msg_docs/topics.md list them."""

import re
from pathlib import Path

TOPICS = Path(__file__).parents[2] / "msg_docs" / "topics.md"


def table() -> list[tuple[str, str, str, str, str]]:
    """Return node, full name, type, kind and quality of service of each row of the tables."""
    found = []
    for section in TOPICS.read_text("utf-8").split("\n## `")[1:]:
        node = section.partition("`")[0]
        rows = re.findall(
            r"^\| `(\S+)` \| (\S+/\S+) \| (\w+) \| ([^|]*)\|", section.partition("\n## ")[0], re.M
        )
        found += [
            (node, f"/{name.replace('~', node).lstrip('/')}", kind, verb, qos.strip())
            for name, kind, verb, qos in rows
        ]
    return found


def types_of(name: str) -> set[str]:
    """Return the types of a topic or service, which may be that of a robot in a namespace."""
    found = {(full, kind) for _, full, kind, _, _ in table()}
    # A service may be in the text, followed by its type in brackets.
    for section in TOPICS.read_text("utf-8").split("\n## `")[1:]:
        node = section.partition("`")[0]
        found |= {
            (f"/{node}{own}", kind)
            for own, kind in re.findall(r"`~(/\w+)`\s+\((\S+/srv/\w+)\)", section)
        }
    names = (f"/{name.lstrip('/')}", re.sub(r"^/\w+(?=/)", "", name))
    return {kind for full, kind in found if full in names}
