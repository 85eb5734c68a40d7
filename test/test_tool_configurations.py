# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Configurations of RViz and Foxglove: they show topics that the nodes publish."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
OTHERS = {"markers", "robot_description", "clicked_point", "initialpose"}
"""Topics of the marker node, of robot_state_publisher, and of tools of Foxglove."""


def documented() -> set[str]:
    text = (ROOT / "msg_docs" / "topics.md").read_text()
    names: set[str] = set()
    for node in ("simulator", "controller"):
        section = text.split(f"\n## `{node}`\n")[1].split("\n## ")[0]
        names |= {name.replace("~", node) for name in re.findall(r"^\| `(\S+)` \|", section, re.M)}
    return {name.lstrip("/") for name in names} | OTHERS


def strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield key
            yield from strings(item)
    elif isinstance(value, list):
        for item in value:
            yield from strings(item)


def test_rviz_shows_documented_topics() -> None:
    manager = YAML(typ="safe").load(ROOT / "rviz" / "sphere.rviz")["Visualization Manager"]
    shown = [*manager["Displays"], *manager["Tools"]]
    topics = {
        entry[key]["Value"] for entry in shown for key in ("Topic", "Description Topic")
        if key in entry
    }
    assert topics <= documented()
    assert {"pose", "odom", "markers", "goal_pose", "controller/predicted_path"} <= topics
    assert manager["Global Options"]["Fixed Frame"] == "world"


def test_foxglove_shows_documented_topics() -> None:
    layout = json.loads((ROOT / "foxglove" / "sphere.json").read_text())
    topics = {s[1:].partition(".")[0] for s in strings(layout) if re.match(r"/[a-z]", s)}
    assert topics <= documented()


def test_foxglove_places_every_panel_once() -> None:
    layout = json.loads((ROOT / "foxglove" / "sphere.json").read_text())

    def placed(part: Any) -> Iterator[str]:
        if isinstance(part, str):
            yield part
        else:
            yield from placed(part["first"])
            yield from placed(part["second"])

    assert sorted(placed(layout["layout"])) == sorted(layout["configById"])
