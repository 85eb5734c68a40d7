# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Classes that are chosen by name: those of this package and those that installed packages bring.

An installed package brings a class by an entry point; `docs/extending.md` says how.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from sphere_nmpc.errors import InvalidParameterError, printable_line
from sphere_nmpc.foreign.code import called


@dataclass(frozen=True)
class Entry:
    """A class that can be chosen by name."""

    path: str
    """Where the class is, as ``module:Class``; imported when it is first needed."""


E = TypeVar("E", bound=Entry)


class EntryTable(dict[str, E]):
    """Table of all classes of a kind by name; an entry that is added is a choice, too.

    Parameters
    ----------
    kind : str
        What the classes are, and the parameter that chooses one: ``strategy``.
    group : str
        Group of the entry points by which installed packages bring entries of their own.
    contract : str
        Where the protocol is whose methods each class has, as ``module:Class``.
    own : Mapping[str, Entry]
        Entries of this package; their names cannot be taken by installed packages.
    entry : callable
        Makes an entry from the path of an entry point.
    """

    def __init__(
        self, kind: str, group: str, contract: str, own: Mapping[str, E],
        entry: Callable[[str], E],
    ) -> None:
        others = {found.name: entry(found.value) for found in entry_points(group=group)}
        super().__init__({**own, **{name: others[name] for name in others if name not in own}})
        self.own = frozenset(own)
        """Names of this package's classes."""
        self._kind, self._contract = kind, contract

    def load(self, name: str) -> Any:
        """Return the class of a name, imported.

        Raises
        ------
        InvalidParameterError
            If there is no such name, the class cannot be imported, or lacks a method.
        """
        if name not in self:
            raise InvalidParameterError(self._kind, name, " or ".join(self))
        path = self[name].path
        try:
            found = called(_imported, path)
        except Exception as error:  # of a module of somebody else
            cause = f"{type(error).__name__}: {printable_line(str(error))}"
            raise InvalidParameterError(
                self._kind, path, f"a class that can be imported ({cause})"
            ) from error
        self.check(found, path, "a class")
        return found

    def check(self, found: object, given: object, what: str = "an object") -> None:
        """Raise `InvalidParameterError` if a class or object lacks a method of the contract."""
        methods = [
            method for method, function in vars(_imported(self._contract)).items()
            if inspect.isfunction(function) and not method.startswith("_")
        ]
        missing = [method for method in methods if not callable(getattr(found, method, None))]
        if missing:
            raise InvalidParameterError(
                self._kind, given,
                f"{what} with {', '.join(methods)} (it lacks {', '.join(missing)})",
            )


def _imported(path: str) -> Any:
    return EntryPoint("", path, "").load()
