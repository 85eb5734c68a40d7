# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Write msg_docs/parameters.md and config/sphere.yaml from the quantities of the settings.

``python bench/documents/parameter_tables.py`` in the source tree; a test holds both files against
what this writes.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import Quantity, quantities
from sphere_nmpc.ros.scheduling import SchedulingSettings
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import PushSettings, SimulatorSettings

NODES: dict[str, Any] = {"simulator": SimulatorSettings(), "controller": ControllerSettings()}
"""Settings of each node; both have those of the robot too, under ``robot.``."""

PARTS: dict[str, tuple[tuple[str, str, Any], ...]] = {
    "simulator": (
        ("", "How the process is scheduled.", SchedulingSettings()),
        ("", "Where the plant can be pushed.", PushSettings()),
        ("rigid_body", "What the plant rigid_body is like.", RigidBodySettings()),
    ),
    "controller": (("", "How the process is scheduled.", SchedulingSettings()),),
}
"""Further settings of a node: prefix, what they are for, values."""

_ROOT = Path(__file__).parents[2]

_DOCUMENT = """\
# Parameters

Written by `python bench/documents/parameter_tables.py` from the settings in the code; not to be
edited here. `config/sphere.yaml` holds every parameter with its default.

All values are SI. A whole number will do where a real one is expected. **live** parameters can be
changed while the node runs (`ros2 param set`); a change that does not fit is refused as a whole,
with the reason. All others are read-only. A value in a file or on the command line that does not
fit ends the node at once with one line that names it and exit code 1; a name that is not known is
told in one warning and ignored.

`use_sim_time` is every node's own: `true` for the controller when the simulator's `/clock` is to
be followed, and left alone for the simulator, which keeps that clock.
"""

_YAML_HEAD = """\
# Every parameter of simulator and controller with its default; SI units.
# Written by `python bench/documents/parameter_tables.py`: copy it and change the copy.
#   ros2 run sphere_nmpc simulator --ros-args --params-file my_sphere.yaml
"""


def parameters_document() -> str:
    """Return the text of msg_docs/parameters.md."""
    parts = [_DOCUMENT]
    for node, settings in NODES.items():
        parts.append(f"\n## `{node}`\n\n{_table(settings)}")
        for prefix, about, more in PARTS[node]:
            parts.append(f"\n{about}\n\n{_table(more, f'{prefix}.' if prefix else '')}")
    robot = _table(RobotParameters(), "robot.")
    parts.append(f"\n## Both nodes: the robot\n\nWhat is true for the simulator, what is believed "
                 f"by the controller.\n\n{robot}")
    return "".join(parts)


def parameters_yaml() -> str:
    """Return the text of config/sphere.yaml."""
    # No section for all nodes, "/**": with one in the file, rcl lets the file win over "-p".
    lines = [_YAML_HEAD.rstrip("\n")]
    for node, settings in NODES.items():
        lines += ["", f"/**/{node}:", "  ros__parameters:"]
        if node == "controller":
            lines += ["    # Follow the simulator's /clock.", "    use_sim_time: true"]
        lines += _entries(settings, 4)
        for prefix, about, more in PARTS[node]:
            lines += [f"    # {about}", *([f"    {prefix}:"] if prefix else [])]
            lines += _entries(more, 6 if prefix else 4)
        role = "What is true" if node == "simulator" else "What is believed"
        lines += [f"    # {role} of the robot.", "    robot:"]
        lines += _entries(RobotParameters(), 6)
    return "\n".join(lines) + "\n"


def main() -> int:
    """Write both files into the source tree."""
    for path, text in outputs().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(f"wrote {path}")
    return 0


def outputs() -> dict[Path, str]:
    """Return the files and what belongs into them."""
    return {
        _ROOT / "msg_docs" / "parameters.md": parameters_document(),
        _ROOT / "config" / "sphere.yaml": parameters_yaml(),
    }


def _table(settings: Any, prefix: str = "") -> str:
    rows = [
        "| name | type | default | unit | range | live | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, value, about in _fields(settings):
        live = "yes" if about.live else ""
        rows.append(
            f"| `{prefix}{name}` | {_type(value)} | {_literal(value)} | {about.unit} "
            f"| {_range(about)} | {live} | {about.description} |"
        )
    return "\n".join(rows) + "\n"


def _entries(settings: Any, indent: int) -> list[str]:
    lines = []
    for name, value, about in _fields(settings):
        unit = "" if about.unit == "-" else f" [{about.unit}]"
        facts = (about.description + unit, _range(about), "live" if about.live else "")
        lines += [f"# {'; '.join(filter(None, facts))}", f"{name}: {_literal(value)}"]
    return [" " * indent + line for line in lines]


def _fields(settings: Any) -> Iterator[tuple[str, Any, Quantity]]:
    about = quantities(settings)
    for field in dataclasses.fields(settings):
        if field.name in about:
            yield field.name, getattr(settings, field.name), about[field.name]


def _type(value: Any) -> str:
    names = {bool: "bool", int: "integer", float: "double", str: "string", tuple: "double array"}
    return names[type(value)]


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_literal, value))}]"
    if isinstance(value, float) and "e" in repr(value):
        # YAML 1.1 takes 1e8 for a text: it wants a point and the exponent's sign.
        mantissa, exponent = repr(value).split("e")
        point = mantissa if "." in mantissa else f"{mantissa}.0"
        return f"{point}e{int(exponent):+d}"
    return repr(value) if not isinstance(value, str) else value or '""'


def _range(about: Quantity) -> str:
    if about.choices:
        return " or ".join(about.choices)
    if about.minimum is None or about.maximum is None:
        return ""
    return f"{about.minimum:.12g} to {about.maximum:.12g}"


if __name__ == "__main__":
    raise SystemExit(main())
