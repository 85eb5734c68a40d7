# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the actions that cause faults."""

from abc import ABC, abstractmethod

from sphere_sim.ros.faults.fault_session import FaultSession


class Action(ABC):
    """A fault that can be begun and ended."""

    @abstractmethod
    def begin(self, session: FaultSession) -> None:
        """Begin the fault."""

    def keep_on(self, session: FaultSession) -> None:  # noqa: B027
        """Do what has to be repeated while the fault lasts; by default nothing."""

    @abstractmethod
    def end(self, session: FaultSession) -> None:
        """End the fault, also one whose `begin` has failed."""

    def clear(self, session: FaultSession) -> None:  # noqa: B027
        """Remove what would be left in the next trial, after the recovery; by default nothing."""
