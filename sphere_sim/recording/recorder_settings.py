# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the recorder."""

from dataclasses import dataclass

from sphere_nmpc.quantity import quantity, validate


@dataclass(frozen=True)
class RecorderSettings:
    """Folder, start and commit period of recordings.

    Raises
    ------
    InvalidParameterError
        If a value is not in its range.
    """

    output: str = quantity(
        "", "-", "Folder of the bag, which must not exist; runs/<date and time> if empty"
    )
    record_on_start: bool = quantity(
        True, "-", "Whether to record from the start, or to wait for the start service"
    )
    commit_period: float = quantity(
        0.5, "s", "Wall time after which received messages are on disk in a readable bag",
        minimum=0.05, maximum=60.0,
    )

    def __post_init__(self) -> None:
        validate(self)
