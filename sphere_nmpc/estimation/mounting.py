# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames in a description of the robot (URDF), and the mounting of a sensor by its frame."""

from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from sphere_nmpc.errors import InvalidInputError, InvalidParameterError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import Vector


class Joint(NamedTuple):
    """Joint: place [m], shape (3,), turn as a quaternion wxyz, (4,), and axis in its parent link.

    The axis, shape (3,), is zero for a fixed one.
    """

    name: str
    parent: str
    place: Vector
    turn: Vector
    axis: Vector


class RobotFrames:
    """Frames of a robot whose joints are fixed or turn, by its description as URDF.

    `InvalidParameterError` is raised for a description that cannot be read.
    """

    def __init__(self, description: str) -> None:
        self.joints: dict[str, Joint] = {}
        """Joints by the frames that they join to a parent link."""
        try:
            for joint in ElementTree.fromstring(description).iterfind("joint"):
                kind = joint.get("type")
                if kind not in ("fixed", "continuous", "revolute"):
                    continue
                parent, child = (joint.find(end).attrib["link"]  # type: ignore[union-attr]
                                 for end in ("parent", "child"))
                self.joints[child] = Joint(
                    joint.get("name", ""), parent, _vector(joint, "origin", "xyz"),
                    _turn(_vector(joint, "origin", "rpy")),
                    np.zeros(3) if kind == "fixed" else _vector(joint, "axis", "xyz", "1 0 0"),
                )
        except (ElementTree.ParseError, AttributeError, KeyError, ValueError) as error:
            raise InvalidParameterError(
                "robot_description", description, f"a robot as URDF ({error})"
            ) from None

    def mounting(self, frame: str, body: str) -> tuple[Vector, Vector]:
        """Return place [m; body frame], shape (3,), and quaternion wxyz, (4,), of a frame.

        Fixed joints have to lead from the link `body` to that of the frame; `InvalidInputError` is
        raised where they do not. The quaternion takes vectors in the frame to the body frame.
        """
        place: Vector = np.zeros(3)
        turn: Vector = np.array([1.0, 0.0, 0.0, 0.0])
        link = frame
        left = {child: joint for child, joint in self.joints.items() if not joint.axis.any()}
        fixed = ", ".join(sorted(left)) or "none"
        while link != body:
            if link not in left:
                raise InvalidInputError(
                    "frame", frame, f"{body}, or a link that fixed joints of robot_description "
                    f"join to it; fixed links are {fixed}",
                )
            _, link, offset, own, _ = left.pop(link)  # each once: joints may lead in a circle
            place, turn = offset + rotation.matrix(own) @ place, rotation.product(own, turn)
        return place, turn


def _vector(joint: ElementTree.Element, tag: str, name: str, default: str = "0 0 0") -> Vector:
    element = joint.find(tag)
    text = default if element is None else element.get(name, default)
    return np.array([float(word) for word in text.split()]).reshape(3)


def _turn(rpy: Vector) -> Vector:
    """Return the quaternion of turns about the fixed axes x, then y, then z [rad]."""
    x, y, z = (rotation.exponential(angle * axis)
               for angle, axis in zip(rpy, np.eye(3), strict=True))
    return rotation.product(z, rotation.product(y, x))
