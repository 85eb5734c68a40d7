# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nonlinear model predictive control of a sphere rolled by two internal rotors.

The public names of the package are those of ``__init__.pyi``, each loaded when it is first used;
modules are not public.
"""

__version__ = "0.1.0"


def public_modules(stub: str) -> dict[str, str]:
    """Return the modules of public names by name, from a stub that imports them.

    Each has a line ``from MODULE import NAME as NAME``.
    """
    with open(stub, encoding="utf-8") as lines:
        words = [line.split() for line in lines if line.startswith("from ")]
    return {line[-1]: line[1] for line in words}


def public(package: str, stub: str, name: str) -> object:
    """Return what a package has by a public name, or the names for ``__all__``."""
    modules = public_modules(stub)
    if name == "__all__":
        return list(modules)
    if name not in modules:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    # Here, as most commands start without it.
    from importlib import import_module

    return getattr(import_module(modules[name]), name)


def __getattr__(name: str) -> object:
    found = globals()[name] = public(__name__, f"{__file__}i", name)
    return found


def __dir__() -> list[str]:
    return [*globals(), *public_modules(f"{__file__}i")]
