# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings dataclasses as ROS parameters, declared from the description of each quantity."""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.foreign_text import shown
from sphere_nmpc.quantity import Quantity, quantities

S = TypeVar("S")

_OF_NODE: WeakKeyDictionary[Node, list[Any]] = WeakKeyDictionary()
_OF_RCLPY = ("use_sim_time", "start_type_description_service", "qos_overrides")


class DeclaredSettings(Generic[S]):
    """Settings dataclass whose fields are declared as parameters of a node.

    The node must be made with ``automatically_declare_parameters_from_overrides=True``, so that
    values from a file or the command line can be read before they are given a type.

    Parameters
    ----------
    node : Node
        Where the parameters are declared.
    default : dataclass instance
        Defaults; its quantities give types, ranges and descriptions.
    prefix : str, optional
        Prefix of each name, before a dot: ``robot`` gives ``robot.shell_mass``.
    on_change : callable, optional
        Called with the new settings after a live change.

    Raises
    ------
    InvalidParameterError
        Naming the parameter whose given value is not accepted.
    """

    def __init__(
        self,
        node: Node,
        default: S,
        prefix: str = "",
        on_change: Callable[[S], object] | None = None,
    ) -> None:
        self._prefix = f"{prefix}." if prefix else ""
        self._about = quantities(default)
        self._default: Any = default
        self._on_change = on_change
        given = {field: _take(node, self._prefix + field) for field in self._about}
        self.settings: S = self._with(default, {k: v for k, v in given.items() if v is not None})
        """The present values."""
        for field, about in self._about.items():
            value = _plain(getattr(self.settings, field))
            node.declare_parameter(
                self._prefix + field, value, describe(about, value), ignore_override=True
            )
        self._register_conversion(node)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    @property
    def names(self) -> list[str]:
        """Full names of the parameters."""
        return [self._prefix + field for field in self._about]

    def _with(self, settings: S, changes: dict[str, Any]) -> S:
        typed = {k: _typed(v, getattr(self._default, k)) for k, v in changes.items()}
        try:
            return dataclasses.replace(settings, **typed)  # type: ignore[type-var]
        except InvalidParameterError as error:
            full_name = self._prefix + error.name
            raise InvalidParameterError(full_name, error.given, error.expected) from None

    def _own(self, parameters: list[Parameter]) -> dict[str, Any]:
        start = len(self._prefix)
        return {p.name[start:]: p.value for p in parameters if p.name in self.names}

    def _register_conversion(self, node: Node) -> None:
        """Convert values given to the node, so that ``5`` is accepted for ``5.0``.

        One callback for all settings of a node: rclpy passes the same list to each callback and
        joins their results.
        """
        siblings = _OF_NODE.setdefault(node, [])
        siblings.append(self)
        if len(siblings) > 1:
            return

        def coerce(parameters: list[Parameter]) -> list[Parameter]:
            for settings in siblings:
                parameters = [settings._coerce(parameter) for parameter in parameters]
            return parameters

        node.add_pre_set_parameters_callback(coerce)

    def _coerce(self, parameter: Parameter) -> Parameter:
        if parameter.name not in self.names or parameter.value is None:
            return parameter
        default = getattr(self._default, parameter.name[len(self._prefix) :])
        return Parameter(parameter.name, value=_plain(_typed(parameter.value, default)))

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        changes = self._own(parameters)
        try:
            if changes:
                self._with(self.settings, changes)
        except InvalidParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        changes = self._own(parameters)
        if changes:
            self.settings = self._with(self.settings, changes)
            if self._on_change is not None:
                self._on_change(self.settings)


def warn_of_unknown(node: Node, known: Iterable[str]) -> None:
    """Warn of given parameters that the node does not have, and undeclare them."""
    declared = set(node.list_parameters([], depth=0).names)
    unknown = sorted(n for n in declared - set(known) if n.split(".")[0] not in _OF_RCLPY)
    for name in unknown:
        node.undeclare_parameter(name)
    if unknown:
        names = shown(", ".join(unknown))
        node.get_logger().warning(
            f"unknown parameters, ignored: {names}; "
            f"'ros2 param list {node.get_fully_qualified_name()}' lists the known ones"
        )


def describe(about: Quantity, value: Any) -> ParameterDescriptor:
    """Return the description of a quantity with present value `value`, with unit and range."""
    unit = "" if about.unit == "-" else f" [{about.unit}]"
    descriptor = ParameterDescriptor(
        description=about.description + unit, read_only=not about.live
    )
    if about.choices:
        descriptor.additional_constraints = "one of: " + ", ".join(about.choices)
    if about.minimum is None or about.maximum is None or isinstance(value, (bool, str)):
        return descriptor
    if isinstance(value, int):
        whole = IntegerRange(from_value=int(about.minimum), to_value=int(about.maximum))
        descriptor.integer_range = [whole]
    else:
        real = FloatingPointRange(from_value=float(about.minimum), to_value=float(about.maximum))
        descriptor.floating_point_range = [real]
    return descriptor


def _take(node: Node, name: str) -> Any:
    """Undeclare a parameter and return the value given for it, None if none was given."""
    if not node.has_parameter(name):
        return None
    value = node.get_parameter(name).value
    node.undeclare_parameter(name)
    return value


def _typed(value: Any, default: Any) -> Any:
    """Return `value` as the type of `default` if that loses no information."""
    if isinstance(default, tuple):
        items = value if hasattr(value, "__iter__") else (value,)
        return tuple(map(float, items)) if all(map(_is_number, items)) else value
    return float(value) if isinstance(default, float) and _is_number(value) else value


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
