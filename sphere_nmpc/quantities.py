# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Physical quantities as validated dataclass fields.

One declaration has the default, unit, range and description of a parameter. The dataclasses are
validated with it, the ROS nodes declare their parameters from it, and a test compares the tables
of parameters in the documentation with it.
"""

import dataclasses
import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from sphere_nmpc.errors import InvalidParameterError

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""
LARGEST = 1e30
"""Largest magnitude of a number that is believed [SI units]: its square is one, too."""
_KEY = "quantity"


def known(number: float) -> float:
    """Return a number of a message; nan, as for an unknown one, where it is beyond `LARGEST`."""
    return float(number) if abs(number) <= LARGEST else float("nan")


def stamp_text(stamp: int) -> str:
    """Return a stamp [ns] as statuses write it: seconds with nine decimals."""
    return "{}.{:09d}".format(*divmod(stamp, NANOSECONDS))


def counted(number: int, name: str) -> str:
    """Return a number of things of a name whose plural ends in s."""
    return f"{number} {name}" if number == 1 else f"{number} {name}s"


@dataclass(frozen=True)
class Quantity:
    """Metadata of a parameter."""

    unit: str
    """SI unit, ``"-"`` for a pure number."""
    description: str
    """One line for ``ros2 param describe``."""
    minimum: float | None = None
    """Least value that is accepted; None where there is no bound."""
    maximum: float | None = None
    """Largest value that is accepted."""
    choices: Collection[str] = ()
    """Accepted values of a text; empty where any text is accepted."""
    live: bool = False
    """Whether the value may change while a node runs."""


def quantity(default: Any, unit: str, description: str, **more: Any) -> Any:
    """Return a dataclass field with unit, range and description in its metadata.

    The type of the default is the type of the parameter; `more` are further attributes of
    `Quantity`.
    """
    about = Quantity(unit, description, **more)
    return dataclasses.field(default=default, metadata={_KEY: about})


def quantities(settings: Any) -> dict[str, Quantity]:
    """Return the metadata of each field of a dataclass or dataclass instance, in order."""
    fields = dataclasses.fields(settings)
    return {field.name: field.metadata[_KEY] for field in fields if _KEY in field.metadata}


def parsed(name: str, text: str, default: Any) -> Any:
    """Return the text of a parameter as the type of its default; commas separate numbers."""
    try:
        if isinstance(default, bool):
            return {"true": True, "false": False}[text.lower()]
        if isinstance(default, tuple):
            return tuple(float(part) for part in text.split(","))
        return type(default)(text)
    except (KeyError, ValueError):
        kind = "true or false" if isinstance(default, bool) else "a number"
        kind = "a whole number" if type(default) is int else kind
        raise InvalidParameterError(name, text, kind) from None


def validate(settings: Any) -> None:
    """Check every quantity of a dataclass instance against its type, range and choices.

    `InvalidParameterError` names the first invalid field, the value given and what is expected.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(settings)}
    for name, about in quantities(settings).items():
        _check(name, getattr(settings, name), defaults[name], about)


def _check(name: str, value: Any, default: Any, about: Quantity) -> None:
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InvalidParameterError(name, value, "true or false")
    elif isinstance(default, str):
        if not isinstance(value, str) or (about.choices and value not in about.choices):
            expected = " or ".join(about.choices) if about.choices else "a text"
            raise InvalidParameterError(name, value, expected)
    elif isinstance(default, tuple) and isinstance(default[0], str):
        if isinstance(value, str) or not value or not all(isinstance(one, str) for one in value):
            raise InvalidParameterError(name, value, "a list of texts")
    elif isinstance(default, tuple):
        if isinstance(value, str) or not hasattr(value, "__len__") or len(value) != len(default):
            expected = f"{counted(len(default), 'number')} [{about.unit}]"
            raise InvalidParameterError(name, value, expected)
        for item in value:
            _check_number(name, item, value, about)
    else:
        _check_number(name, value, value, about)
        if isinstance(default, int) and not isinstance(value, int):
            raise InvalidParameterError(name, value, "a whole number")


def _check_number(name: str, number: Any, value: Any, about: Quantity) -> None:
    if isinstance(number, bool) or not isinstance(number, (int, float)) or number != number:
        raise InvalidParameterError(name, value, f"a finite number [{about.unit}]")
    low = -math.inf if about.minimum is None else about.minimum
    high = math.inf if about.maximum is None else about.maximum
    # Compared, not converted: a whole number may be too large for a float.
    if not (low <= number <= high and -math.inf < number < math.inf):
        raise InvalidParameterError(name, value, f"{low:g} to {high:g} [{about.unit}]")
