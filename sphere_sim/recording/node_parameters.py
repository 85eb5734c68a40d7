# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node without the node: from a file as nodes take it, or from a bag."""

import dataclasses
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from sphere_nmpc.errors import InvalidParameterError, shown
from sphere_nmpc.foreign.file import InvalidFileError, find_file, read_file, yaml_texts
from sphere_nmpc.quantities import parsed, quantities
from sphere_sim.recording.bag_files import PARAMETERS_PREFIX, object_of

S = TypeVar("S")
_MOST_TEXT, _DEEPEST = 1 << 20, 20
"""Bytes of a file, and levels of its mappings."""
_KEY = "ros__parameters"
_WILD = {"**": "(/[^/]+)*", "*": "/[^/]+"}
"""Expressions for what stands for any namespaces and for any name."""


def file_parameters(path: Path, *nodes: str) -> dict[str, str]:
    """Return the texts of the parameters that a file has for nodes, of full names, by name.

    As for a node, the last section that has one counts, however many wildcards its name has.
    `InvalidFileError` is raised where it has none for any of the nodes.
    """
    try:
        sections = list(_sections(yaml_texts(read_file(find_file(path), _MOST_TEXT), _DEEPEST)))
    except (InvalidFileError, OSError):
        raise
    except Exception as error:  # the parser raises many kinds for a broken file
        raise InvalidFileError(str(path), shown(error), "a YAML file of parameters") from None
    fitting = [values for name, values in sections
               if any(re.fullmatch(_expression(name), node) for node in nodes)]
    if not fitting:
        named = ", ".join(name.lstrip("/") for name, _ in sections)
        raise InvalidFileError(
            str(path), f"sections {named}" if named else f"no section with {_KEY}",
            f"one that is for {nodes[0]}, such as /**/{nodes[0].rpartition('/')[2]}",
        )
    return {name: text for values in fitting for name, text in _flat(values)}


def bag_parameters(custom_data: Mapping[str, str], node: str) -> dict[str, str]:
    """Return the texts of a node's parameters in a bag's custom data; none where it has none."""
    return dict(_flat(object_of(custom_data.get(f"{PARAMETERS_PREFIX}{node}", ""))))


def with_parameters(default: S, texts: Mapping[str, str], prefix: str = "") -> S:
    """Return settings with the texts of their parameters, whose names begin with `prefix`."""
    changes = {
        field: parsed(f"{prefix}{field}", texts[f"{prefix}{field}"], getattr(default, field))
        for field in quantities(default) if f"{prefix}{field}" in texts
    }
    try:
        return dataclasses.replace(default, **changes)  # type: ignore[type-var]
    except InvalidParameterError as error:
        name = error.name if error.name.startswith(prefix) else f"{prefix}{error.name}"
        raise InvalidParameterError(name, error.given, error.expected) from None


def _sections(content: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names of nodes and their parameters; names may be in names, as in namespaces."""
    # `yaml_texts` has the last one first.
    for key, value in reversed(content.items()) if isinstance(content, dict) else ():
        if key == _KEY:
            yield name, value
        else:
            yield from _sections(value, f"{name}/{key.strip('/')}")


def _expression(name: str) -> str:
    return "".join(_WILD.get(part) or f"/{re.escape(part)}" for part in name.split("/")[1:])


def _flat(values: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield full names and texts of parameters."""
    for name, value in values.items() if isinstance(values, dict) else ():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            items = value if isinstance(value, list) else [value]
            yield f"{prefix}{name}", ",".join(map(str, items))
