# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Whatever values are in range, a node has them as they were written, in a file or live."""

from pathlib import Path
from typing import Any

import pytest
import rclpy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")

from rclpy.node import Node
from rclpy.parameter import Parameter

from sphere_nmpc.quantity import Quantity, quantities
from sphere_nmpc.ros.parameters import DeclaredSettings
from sphere_nmpc.settings import ControllerSettings

DEFAULT = ControllerSettings()
ABOUT = quantities(DEFAULT)
FEW = settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])


def values(name: str, about: Quantity) -> st.SearchStrategy[Any]:
    """Return values that are accepted, for all that does not depend on other parameters."""
    default = getattr(DEFAULT, name)
    if isinstance(default, bool):
        return st.booleans()
    if about.choices:
        return st.sampled_from(list(about.choices))
    if about.minimum is None or isinstance(default, (str, tuple)):
        return st.just(default)
    if isinstance(default, int):
        return st.integers(int(about.minimum), int(about.maximum))
    return st.floats(float(about.minimum), float(about.maximum), allow_subnormal=False)


def accepted(given: dict[str, Any]) -> bool:
    """Return whether the settings, which know what goes together, take the values."""
    try:
        ControllerSettings(**given)
    except ValueError:
        return False
    return True


SOME = st.fixed_dictionaries(
    {}, optional={name: values(name, about) for name, about in ABOUT.items()}
).filter(accepted)
LIVE = st.fixed_dictionaries(
    {}, optional={name: values(name, about) for name, about in ABOUT.items() if about.live}
).filter(lambda given: given and accepted(given))


def text(value: Any) -> str:
    """Return a value as YAML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.17e}" if isinstance(value, float) else str(value)


def declared(*arguments: str) -> tuple[Node, DeclaredSettings[ControllerSettings]]:
    node = Node(
        "controller", cli_args=["--ros-args", *arguments],
        automatically_declare_parameters_from_overrides=True,
    )
    return node, DeclaredSettings(node, DEFAULT)


@pytest.fixture
def context(graph) -> None:
    """Somewhere for nodes to live."""
    assert rclpy.ok()


@FEW
@given(given=SOME)
def test_values_of_a_file_are_those_of_the_node(context, tmp_path: Path, given) -> None:
    path = tmp_path / "values.yaml"
    lines = ["controller:", "  ros__parameters:", "    use_sim_time: false"]
    path.write_text("\n".join([*lines, *(f"    {n}: {text(v)}" for n, v in given.items())]))
    node, settings_ = declared("--params-file", str(path))
    try:
        assert settings_.settings == ControllerSettings(**given)
        for name, value in given.items():
            assert node.get_parameter(name).value == value
    finally:
        node.destroy_node()


@FEW
@given(given=LIVE)
def test_values_that_are_set_live_are_in_force(context, given) -> None:
    node, settings_ = declared()
    try:
        result = node.set_parameters_atomically(
            [Parameter(name, value=value) for name, value in given.items()]
        )
        assert result.successful, result.reason
        assert settings_.settings == ControllerSettings(**given)
    finally:
        node.destroy_node()
