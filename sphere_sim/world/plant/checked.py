# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plant of another package, whose failures and wrong quantities are errors that name it."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sphere_nmpc.errors import SphereNmpcError, reason_of
from sphere_nmpc.foreign.code import called
from sphere_nmpc.model.state import Vector, as_state
from sphere_sim.world.plant.contract import PlantError
from sphere_sim.world.walls import Contact

SIZES = {
    "state": 6, "velocity": 3, "body_rate": 3, "momentum": 3, "gravity": 3, "rotor_angles": 2,
    "rotor_speeds": 2, "rotor_torques": 2,
}
"""Sizes of the quantities of a plant."""


class CheckedPlant:
    """A plant with the same methods and quantities, which are checked at each use.

    `PlantError` is raised if a method or property of the plant raises, or a quantity has another
    shape, is not finite, or, as a state, has no unit quaternion. Quantities are copies, so that a
    plant may return its own arrays.

    Parameters
    ----------
    name : str
        Name of the plant in the table.
    make : callable
        Makes the plant.
    """

    def __init__(self, name: str, make: Callable[[], Any]) -> None:
        self._name = name
        self._plant = self._tried("cannot be made", make)
        for quantity in SIZES:
            getattr(self, quantity)
        contact = self._tried("contact", lambda: self._plant.contact)
        if not isinstance(contact, Contact):
            raise self._error("contact", f"given {type(contact).__name__}, expected Contact")
        self.contact = contact

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        size = SIZES.get(name)
        if size is not None:
            return self._quantity(name, size)

        def call(*arguments: Any) -> None:
            self._tried(name, lambda: getattr(self._plant, name)(*arguments))
            self._quantity("state", SIZES["state"])

        return call

    def _quantity(self, name: str, size: int) -> Vector:
        found: Vector = self._tried(
            name, lambda: np.array(getattr(self._plant, name), dtype=float)
        )
        if found.shape != (size,) or not np.isfinite(found).all():
            given = f"{found.tolist()}" if found.size <= size else f"the shape {found.shape}"
            raise self._error(name, f"given {given}, expected {size} finite numbers")
        return self._tried(name, lambda: as_state(found)) if name == "state" else found

    def _tried(self, what: str, call: Callable[[], Any]) -> Any:
        try:
            return called(call)
        except MemoryError:
            raise
        except Exception as error:
            raise self._error(what, reason_of(error), error) from error

    def _error(self, what: str, why: str, cause: Exception | None = None) -> PlantError:
        error = PlantError(f"plant {self._name}: {what}: {why}")
        if isinstance(cause, SphereNmpcError):
            error.exit_code = cause.exit_code
        return error
