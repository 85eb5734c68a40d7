# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings that nodes have beside those of controller, simulator and robot."""

from dataclasses import dataclass

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.quantity import quantity, validate
from sphere_nmpc.ros.messages import WORLD_FRAME


@dataclass(frozen=True)
class FrameSettings:
    """Frame that poses and goals are given in.

    Raises
    ------
    InvalidParameterError
        If it is empty or begins with a slash, which tf2 refuses.
    """

    world_frame: str = quantity(
        WORLD_FRAME, "-",
        "Frame of poses, goals and plans; those in another frame are refused, those without one "
        "are taken to be in it",
    )

    def __post_init__(self) -> None:
        validate(self)
        if not self.world_frame or self.world_frame.startswith("/"):
            raise InvalidParameterError(
                "world_frame", self.world_frame, "a name that begins without /"
            )
