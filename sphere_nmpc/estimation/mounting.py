# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Mounting of a sensor by its frame in a description of the robot (URDF)."""

from xml.etree import ElementTree

import numpy as np

from sphere_nmpc.errors import InvalidInputError, InvalidParameterError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import Vector


class FixedFrames:
    """Frames that fixed joints join to a robot, by its description as URDF.

    `InvalidParameterError` is raised for a description that cannot be read.
    """

    def __init__(self, description: str) -> None:
        self._parents: dict[str, tuple[str, Vector, Vector]] = {}
        try:
            for joint in ElementTree.fromstring(description).iterfind("joint[@type='fixed']"):
                origin = joint.find("origin")
                given = {} if origin is None else origin.attrib
                xyz, rpy = (
                    np.array([float(word) for word in given.get(name, "0 0 0").split()]).reshape(3)
                    for name in ("xyz", "rpy")
                )
                parent, child = (joint.find(end).attrib["link"]  # type: ignore[union-attr]
                                 for end in ("parent", "child"))
                self._parents[child] = parent, xyz, rpy
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
        left = dict(self._parents)
        while link != body:
            if link not in left:
                fixed = ", ".join(sorted(self._parents)) or "none"
                raise InvalidInputError(
                    "frame", frame, f"{body}, or a link that fixed joints of robot_description "
                    f"join to it; fixed links are {fixed}",
                )
            link, offset, angles = left.pop(link)  # each once: joints may lead in a circle
            own = _turn(angles)
            place, turn = offset + rotation.matrix(own) @ place, rotation.product(own, turn)
        return place, turn


def _turn(rpy: Vector) -> Vector:
    """Return the quaternion of turns about the fixed axes x, then y, then z [rad]."""
    x, y, z = (rotation.exponential(angle * axis)
               for angle, axis in zip(rpy, np.eye(3), strict=True))
    return rotation.product(z, rotation.product(y, x))
