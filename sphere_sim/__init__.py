# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulation, studies, recording and visualisation around the controller.

The public names of the package are those of ``__init__.pyi``, each loaded when it is first used;
modules are not public.
"""

from sphere_nmpc import public, public_modules


def __getattr__(name: str) -> object:
    found = globals()[name] = public(__name__, f"{__file__}i", name)
    return found


def __dir__() -> list[str]:
    return [*globals(), *public_modules(f"{__file__}i")]
