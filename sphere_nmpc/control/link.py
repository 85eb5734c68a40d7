# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Delay and loss of commands on their way to the rotors, and of poses on their way back."""

import math
from collections import deque

import numpy as np

from sphere_nmpc.estimation.rotor_history import LONGEST_WINDOW, RotorHistory
from sphere_nmpc.reporting.recent import Recent

_MAX_POSES = 256
"""Poses that delay and loss are taken of."""
_MIN_LINK_DELAY = 5e-3
"""Delay of poses [s] below which there is no link, only the time that a message takes."""
_MAX_LOSS = 0.01
"""Share of lost commands up to which the link counts as without losses."""


class Link:
    """Delay and loss of commands and poses, as far as measured rotor speeds and stamps show them.

    From the delays follows the commitment window: how far ahead a new plan may first differ from
    the one in force. Commands are expected to be at least as late as poses, and without measured
    speeds to be lost as often. Measured speeds that the motion contradicts are not used.

    Times are control times [s].

    Parameters
    ----------
    rotors : RotorHistory
        History of the commands, with the measured speeds.
    """

    def __init__(self, rotors: RotorHistory) -> None:
        self._rotors = rotors
        self._times: deque[float] = deque(maxlen=_MAX_POSES)
        self._ages = Recent(_MAX_POSES)

    def pose_received(self, time: float, age: float) -> None:
        """Record a pose measured at `time` [s], which is `age` old; nan if that is unknown."""
        if self._times and time <= self._times[-1]:
            if time > self._times[0]:
                return  # Overtaken by a newer one.
            self._times.clear()
            self._ages.clear()
        self._times.append(time)
        if not math.isnan(age):
            self._ages.append(age)

    @property
    def pose_delay(self) -> float:
        """Mean age of the poses when they were received [s]; nan if unknown.

        Where the clock is a topic, it is delayed as well, so that the age shows the difference.
        """
        return self._ages.mean

    @property
    def pose_loss(self) -> float:
        """Share of poses that were not received, from the gaps between stamps; nan if unknown."""
        if len(self._times) < 3:
            return math.nan
        gaps = np.diff(self._times)
        missing = float(np.sum(np.maximum(0.0, np.round(gaps / np.median(gaps)) - 1.0)))
        return missing / (missing + gaps.size)

    @property
    def window(self) -> float:
        """Delay that commands may have without being late [s]; 0 without a link."""
        late = 0.0 if self._rotors.contradicted else max(self._rotors.delays, default=0.0)
        delay = self.pose_delay
        return min(max(late, delay if delay > _MIN_LINK_DELAY else 0.0), LONGEST_WINDOW)

    @property
    def loss(self) -> float:
        """Share of the newest commands that did not take effect before the next one."""
        is_measured = self._rotors.is_measured and not self._rotors.contradicted
        loss = self._rotors.losses.mean if is_measured else self.pose_loss
        return 0.0 if math.isnan(loss) else loss

    @property
    def is_apparent(self) -> bool:
        """Whether commands have been late or lost lately."""
        return self.window > 0.0 or self.loss > _MAX_LOSS

    @property
    def needs_speeds(self) -> bool:
        """Whether measured speeds are of use: not where all commands take effect in time."""
        return not self._rotors.is_known or self.is_apparent or self._rotors.contradicted
