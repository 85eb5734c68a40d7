# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings dataclasses as ROS parameters, declared from the description of each quantity."""

import dataclasses
from collections.abc import Callable, Generator
from concurrent.futures import Future
from functools import partial
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

from sphere_nmpc.errors import InvalidParameterError, reason_of, shown
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import Quantity, quantities

S = TypeVar("S")

Prepare = Callable[[Callable[[], S], set[str], bool], Future[Callable[[], object]]]
"""Begins to make what changed settings need, and returns a future of what puts it in force, or of
the error that refuses it. The first argument returns the settings, for the thread that makes it,
the second has the fields that were set. The third says whether to return only when it is made;
otherwise the future is done by the executor of the node."""
_OF_RCLPY = ("use_sim_time", "start_type_description_service", "qos_overrides")
_OF_ROBOT = {f"robot.{name}" for name in quantities(RobotParameters)}


class DeclaredSettings(Generic[S]):
    """Settings dataclass whose fields are parameters of a node; see `Parameters.declare`."""

    def __init__(
        self, default: S, prefix: str, on_change: Callable[[S], object] | None,
        prepare: Prepare[S] | None,
    ) -> None:
        self._default: Any = default
        self._on_change, self._prepare = on_change, prepare
        self.prepared: Future[Callable[[], object]] | None = None
        """What was made for the values that are being set."""
        self._prefix = f"{prefix}." if prefix else ""
        self.fields = {f"{self._prefix}{field}": field for field in quantities(default)}
        """Fields by the full names of their parameters."""
        self.settings = default
        """The present values."""

    def typed(self, name: str, value: Any) -> Any:
        """Return a value as the type of its field if that loses no information."""
        default = getattr(self._default, self.fields[name])
        if isinstance(default, tuple):
            items = value if hasattr(value, "__iter__") else (value,)
            if isinstance(default[0], str):
                return value if isinstance(value, str) else tuple(items)
            return tuple(map(float, items)) if all(map(_is_number, items)) else value
        return float(value) if isinstance(default, float) and _is_number(value) else value

    def changed(self, values: dict[str, Any]) -> S:
        """Return the settings with other values, by full name."""
        changes = {self.fields[name]: self.typed(name, value) for name, value in values.items()}
        try:
            return dataclasses.replace(self.settings, **changes)  # type: ignore[type-var]
        except InvalidParameterError as error:
            raise InvalidParameterError(
                self._prefix + error.name, error.given, error.expected
            ) from None

    def prepare(self, values: dict[str, Any], wait: bool) -> Future[Callable[[], object]] | None:
        """Begin to make what values need that are to be set, by full name; see `Prepare`."""
        if self._prepare is None:
            return None
        names = {self.fields[name] for name in values}
        return self._prepare(partial(self.changed, values), names, wait)

    def check(self, values: dict[str, Any]) -> Callable[[], object]:
        """Return what puts in force what values need, by full name; raise an error to refuse them.

        It is what was prepared for them.
        """
        made = self.prepared or self.prepare(values, wait=True)
        if made is not None:
            return made.result()
        self.changed(values)
        return lambda: None

    def apply(self, values: dict[str, Any]) -> None:
        """Take over values that were accepted."""
        self.settings = self.changed(values)
        if self._on_change is not None:
            self._on_change(self.settings)


class Parameters:
    """Parameters of a node that are declared from settings dataclasses.

    The node must be made with ``automatically_declare_parameters_from_overrides=True``, so that
    values from a file or the command line can be read before they are given a type.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._owners: dict[str, DeclaredSettings[Any]] = {}
        # One for all settings: rclpy passes the same list to each callback and joins the results.
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def declare(
        self, default: S, prefix: str = "", on_change: Callable[[S], object] | None = None,
        prepare: Prepare[S] | None = None,
    ) -> DeclaredSettings[S]:
        """Declare the fields of a settings dataclass, and return its values as they are given.

        The quantities of `default` give types, ranges and descriptions. Names begin with `prefix`
        and a dot: ``robot.shell_mass``. `on_change` is called with the settings after a live
        change; with `prepare` one is accepted only once what it needs has been made. A given
        value that is not accepted raises `InvalidParameterError`.
        """
        declared = DeclaredSettings(default, prefix, on_change, prepare)
        given = {name: _take(self._node, name) for name in declared.fields}
        values = {name: value for name, value in given.items() if value is not None}
        declared.settings = declared.changed(values)
        about = quantities(default)
        for name, field in declared.fields.items():
            value = _plain(getattr(declared.settings, field))
            self._node.declare_parameter(
                name, value, describe(about[field], value), ignore_override=True
            )
        self._owners |= dict.fromkeys(declared.fields, declared)
        return declared

    def warn_of_unknown(self) -> None:
        """Warn of given parameters that the node does not have, and undeclare them.

        Those of the robot may be given to all nodes at once, also to those without need of them.
        """
        node = self._node
        names = set(node.list_parameters([], depth=0).names) - set(self._owners)
        others = sorted(name for name in names if name.split(".")[0] not in _OF_RCLPY)
        for name in others:
            node.undeclare_parameter(name)
        unknown = [name for name in others if name not in _OF_ROBOT]
        if unknown:
            node.get_logger().warning(
                f"unknown parameters, ignored: {shown(', '.join(unknown))}; "
                f"'ros2 param list {node.get_fully_qualified_name()}' lists the known ones"
            )

    def answer(
        self, set_now: Callable[[Any, Any], Any], request: Any, response: Any
    ) -> Generator[Future[Any], None, Any]:
        """Answer a request to set parameters, once what each of its changes needs is made.

        A read-only parameter is accepted with the value that it has, as a file that was dumped is
        loaded. `set_now` is rclpy's own callback of the service; for the generator see
        `GuardedNode`.
        """
        given = list(request.parameters)
        is_whole = isinstance(request, SetParametersAtomically.Request)
        for asked in [given] if is_whole else [[one] for one in given]:
            read = [Parameter.from_parameter_msg(one) for one in asked]
            changes = [one for one in read if not self._is_kept(one)]
            if asked and not changes:
                accepted = SetParametersResult(successful=True)
                if is_whole:
                    response.result = accepted
                else:
                    response.results.append(accepted)
                continue
            values = self._by_owner(changes)
            made = {owner: owner.prepare(some, wait=False) for owner, some in values.items()}
            for future in made.values():
                if future is not None:
                    yield future
            for owner, future in made.items():
                owner.prepared = future
            try:
                part = [one.to_parameter_msg() for one in changes]
                set_now(type(request)(parameters=part), response)
            finally:
                for owner in made:
                    owner.prepared = None
        return response

    def _is_kept(self, given: Parameter) -> bool:
        """Return whether a parameter is read-only and has the given value."""
        name, node = given.name, self._node
        if not (node.has_parameter(name) and node.describe_parameter(name).read_only):
            return False
        (converted,) = self._convert([given])
        kept = node.get_parameter(name)
        return bool(converted.to_parameter_msg() == kept.to_parameter_msg())

    def _convert(self, parameters: list[Parameter]) -> list[Parameter]:
        """Convert values given to the node, so that ``5`` is accepted for ``5.0``."""
        return [
            Parameter(p.name, value=_plain(self._owners[p.name].typed(p.name, p.value)))
            if p.name in self._owners and p.value is not None else p
            for p in parameters
        ]

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        """Check values; rclpy calls this after what else may refuse them."""
        found = self._by_owner(parameters)
        try:
            # Put in force when all are checked, as that cannot be taken back.
            for put_in_force in [owner.check(values) for owner, values in found.items()]:
                put_in_force()
        except Exception as error:  # also of memory and disk, for what has to be made
            return SetParametersResult(successful=False, reason=reason_of(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        for owner, values in self._by_owner(parameters).items():
            owner.apply(values)

    def _by_owner(
        self, parameters: list[Parameter]
    ) -> dict[DeclaredSettings[Any], dict[str, Any]]:
        found: dict[DeclaredSettings[Any], dict[str, Any]] = {}
        for parameter in parameters:
            if owner := self._owners.get(parameter.name):
                found.setdefault(owner, {})[parameter.name] = parameter.value
        return found


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


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
