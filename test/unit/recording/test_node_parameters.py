# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node that is not there, as the node would take them."""

import json

import pytest
from document_commands import ROOT

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.foreign.file import InvalidFileError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.recording.node_parameters import (
    bag_parameters,
    file_parameters,
    with_parameters,
)


@pytest.mark.parametrize(("section", "node", "is_for"), [
    ("/**", "/odometry", True),
    ("/**", "/left/odometry", True),
    ("/**/odometry", "/odometry", True),
    ("/**/odometry", "/one/left/odometry", True),
    ("odometry", "/odometry", True),
    ("/odometry", "/odometry", True),
    ("/*/odometry", "/left/odometry", True),
    ("/*/odometry", "/odometry", False),
    ("odometry", "/left/odometry", False),
    ("/**/controller", "/odometry", False),
    ("/left/*", "/left/odometry", True),
])
def test_section_is_for_the_nodes_that_ros_has_it_for(section, node, is_for, tmp_path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text(f"{section}: {{ros__parameters: {{robot: {{shell_radius: 0.2}}}}}}")
    if is_for:
        assert file_parameters(file, node) == {"robot.shell_radius": "0.2"}
    else:
        with pytest.raises(InvalidFileError, match="expected one that is for"):
            file_parameters(file, node)


def test_config_of_the_package_has_the_parameters_of_all_nodes() -> None:
    found = file_parameters(ROOT / "config" / "sphere.yaml", "/controller", "/odometry")
    assert with_parameters(ImuSettings(), found, "imu.") == ImuSettings()
    assert with_parameters(ControllerSettings(), found) == ControllerSettings()


def test_names_in_names_and_namespaces_are_joined_and_later_sections_count(tmp_path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text(
        "/**: {ros__parameters: {robot.shell_radius: 0.2, initial_state: [1, 2, 1, 0, 0, 0]}}\n"
        "left: {odometry: {ros__parameters: {robot: {shell_radius: 0.35, shell_mass: 2}}}}\n"
    )
    found = file_parameters(file, "/left/odometry")
    assert with_parameters(RobotParameters(), found, "robot.").shell_radius == 0.35
    given = with_parameters(OdometrySettings(), found)
    assert given.initial_state == (1.0, 2.0, 1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "text", ["", "[]", "a", "a: 1", "- 1\n- 2", "/**: 3", "/**: {a: 1}", "{", "{[", "a: *b",
             "a: b", "[" * 90],
)
def test_file_without_parameters_is_refused_in_one_line(text, tmp_path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text(text)
    with pytest.raises(InvalidFileError) as error:
        file_parameters(file, "/odometry")
    assert "\n" not in str(error.value) and "expected" in str(error.value)


@pytest.mark.parametrize(("texts", "told"), [
    ({"robot.shell_radius": "a"}, "robot.shell_radius: given 'a', expected a number"),
    ({"robot.shell_radius": "-1"}, "robot.shell_radius: given -1.0, expected"),
])
def test_value_that_is_not_accepted_is_named_in_full(texts, told) -> None:
    with pytest.raises(InvalidParameterError, match=told):
        with_parameters(RobotParameters(), texts, "robot.")


def test_recorded_parameters_are_as_the_node_had_them() -> None:
    settings = OdometrySettings(initial_state=(0.1, 0.2, 0.6, 0.8, 0.0, 0.0), fix_memory=2.5)
    recorded = json.dumps({"fix_memory": 2.5, "initial_state": settings.initial_state})
    found = bag_parameters({"parameters:/odometry": recorded}, "/odometry")
    assert with_parameters(OdometrySettings(), found) == settings
    assert bag_parameters({"parameters:/odometry": "[1]"}, "/odometry") == {}
