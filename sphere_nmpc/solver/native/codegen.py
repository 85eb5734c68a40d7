# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""C code of the integration step, generated from the CasADi expressions of the model.

CasADi's code generator supports one number type. Here a nominal value is a ``double`` and a
derivative a ``tangent``, a few vector registers that hold the derivatives along all directions, so
each operation is written once and the nominal value is computed once. That works because the step
is made of sums, products and quotients alone, and a derivative is linear in its seeds: a tangent
is only ever added to a tangent or scaled by a number. ``vectors.h`` defines the tangents.
"""

from collections.abc import Callable
from functools import partial

import casadi as ca

from sphere_nmpc.model.integrator import tangent_drift_step_function, tangent_step_function

_PLACES = {
    "q": ("y", 0), "momentum": ("y", 4), "u_start": ("u_start", 0), "u_end": ("u_end", 0),
    "h": ("h", 0), "p": ("p", 0), "torques": ("torques", 0),
    "dp": ("dp", 0), "dtorques": ("dtorques", 0), "dq": ("dy", 0), "dmomentum": ("dy", 4), "du_start": ("du_start", 0), "du_end": ("du_end", 0),
    "dxy": ("dxy", 0), "q_end": ("y_end", 0), "momentum_end": ("y_end", 4),
    "ddxy": ("ddxy", 0), "dq_end": ("dy_end", 0), "dmomentum_end": ("dy_end", 4),
}
"""Array in C, and first index in it, of each argument and result of the steps of
`sphere_nmpc.model.integrator`: y holds the quaternion and the momentum if there is one."""

_SEED_NAMES = ("dq", "dmomentum", "du_start", "du_end", "dp", "dtorques")

_STEP = ("q", "u_start", "u_end", "h", "p", "dq", "du_start", "du_end"), (
    "dxy", "q_end", "ddxy", "dq_end",
)
_DRIFT_STEP = (
    ("q", "momentum", "u_start", "u_end", "h", "p", "torques",
     "dq", "dmomentum", "du_start", "du_end"),
    ("dxy", "q_end", "momentum_end", "ddxy", "dq_end", "dmomentum_end"),
)
_FITTED_STEP = (
    ("q", "momentum", "u_start", "u_end", "h", "p", "torques",
     "dq", "dmomentum", "dp", "dtorques"),
    _DRIFT_STEP[1],
)
"""Arguments and results of `tangent_step_function` and `tangent_drift_step_function`, the last
ones with the derivatives that an estimator needs."""

_SYMBOL = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_TANGENT_NAME = {ca.OP_ADD: "TANGENT_SUM", ca.OP_SUB: "TANGENT_DIFFERENCE"}

_INPUTS = (
    "const double *restrict y, const double *restrict u_start, const double *restrict u_end, "
    "double h, const double *restrict p, const double *restrict torques"
)
_SEEDS = "const {0} *restrict dy, const {0} *restrict du_start, const {0} *restrict du_end"
_OUTPUTS = "double *restrict dxy, double *restrict y_end"
_TANGENTS = "{0} *restrict ddxy, {0} *restrict dy_end"

Names = tuple[tuple[str, ...], tuple[str, ...]]
"""Names of the arguments and of the results of a function."""

Operands = list[tuple[str, bool]]
"""Name of each operand, and whether it is a tangent."""


def kernel_source() -> str:
    """Return the C functions of a step: alone and with derivatives, without and with drift.

    The last one, ``fitted_step``, has the derivatives that an estimator needs.
    """
    by_inputs = partial(tangent_drift_step_function, varied=("q", "momentum", "u_start", "u_end"))
    by_plant = tangent_drift_step_function(1, ("q", "momentum", "p", "torques"))
    plant_seeds = "const fitted *restrict dy, const fitted *restrict dp, " \
        "const fitted *restrict dtorques"
    return (
        _kernels("without_drift", "tangent", tangent_step_function, _STEP)
        + _kernels("with_drift", "wide_tangent", by_inputs, _DRIFT_STEP)
        + _kernel("fitted_step", "fitted", by_plant, _FITTED_STEP, plant_seeds)
    )


def _kernels(
    model: str, tangent: str, step_function: Callable[[int], ca.Function], names: Names
) -> str:
    value = _body(_without_repetition(step_function(0)), names)
    seeds = _SEEDS.format(tangent)
    return (
        f"static void nominal_step_{model}({_INPUTS}, {_OUTPUTS})\n{{\n{value}}}\n\n"
        + _kernel(f"tangent_step_{model}", tangent, step_function(1), names, seeds)
    )


def _kernel(name: str, tangent: str, function: ca.Function, names: Names, seeds: str) -> str:
    body = _body(_without_repetition(function), names)
    tangents = _TANGENTS.format(tangent)
    return (
        f"static void {name}({_INPUTS}, {seeds}, {_OUTPUTS}, {tangents})\n{{\n{body}}}\n\n"
    )


def _without_repetition(function: ca.Function) -> ca.Function:
    """Return the function with common subexpressions, which differentiation repeats, once each."""
    arguments = function.sx_in()
    return ca.Function(function.name(), arguments, ca.cse(function.call(arguments)))


def _body(function: ca.Function, arguments_and_results: Names) -> str:
    """Translate CasADi's instructions, one statement each."""
    # CasADi reuses its work vector; here every instruction gets a name of its own.
    arguments, results = arguments_and_results
    names: dict[int, str] = {}
    is_tangent: dict[int, bool] = {}
    lines: list[str] = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            place = _place(results[targets[0]], targets[1])
            lines.append(f"{place} = {names[sources[0]]};")
            continue
        target = targets[0]
        name = f"a{k}"
        if operation == ca.OP_INPUT:
            argument = arguments[sources[0]]
            place = _place(argument, sources[1])
            is_tangent[target] = argument in _SEED_NAMES
            lines.append(
                f"TANGENT_COPY({name}, {place})" if is_tangent[target]
                else f"const double {name} = {place};"
            )
        elif operation == ca.OP_CONST:
            is_tangent[target] = False
            # Hexadecimal, so that C reads exactly the same number.
            value = float(function.instruction_constant(k)).hex()
            lines.append(f"const double {name} = {value};")
        else:
            operands = [(names[i], is_tangent[i]) for i in sources]
            is_tangent[target] = any(tangent for _, tangent in operands)
            write = _tangent_statement if is_tangent[target] else _nominal_statement
            lines.append(write(name, operation, operands))
        names[target] = name
    return "".join(f"    {line}\n" for line in lines)


def _place(name: str, index: int) -> str:
    array, first = _PLACES[name]
    return array if array == "h" else f"{array}[{first + index}]"


def _nominal_statement(name: str, operation: int, operands: Operands) -> str:
    left, right = operands[0][0], operands[-1][0]
    if operation in _SYMBOL:
        expression = f"{left} {_SYMBOL[operation]} {right}"
    elif operation == ca.OP_SQ:
        expression = f"{left} * {left}"
    elif operation == ca.OP_TWICE:
        expression = f"{left} + {left}"
    elif operation == ca.OP_NEG:
        expression = f"-{left}"
    elif operation == ca.OP_INV:
        expression = f"1.0 / {left}"
    else:
        raise NotImplementedError(f"operation {operation} has no translation to C")
    return f"const double {name} = {expression};"


def _tangent_statement(name: str, operation: int, operands: Operands) -> str:
    (left, left_varies), (right, right_varies) = operands[0], operands[-1]
    if operation in _TANGENT_NAME and left_varies and right_varies:
        return f"{_TANGENT_NAME[operation]}({name}, {left}, {right})"
    if operation == ca.OP_MUL and left_varies != right_varies:
        number, tangent = (right, left) if left_varies else (left, right)
        return f"TANGENT_SCALED({name}, {number}, {tangent})"
    if operation == ca.OP_DIV and left_varies and not right_varies:
        return f"TANGENT_SCALED({name}, 1.0 / {right}, {left})"
    if operation == ca.OP_TWICE:
        return f"TANGENT_SUM({name}, {left}, {left})"
    if operation == ca.OP_NEG:
        return f"TANGENT_NEGATIVE({name}, {left})"
    raise NotImplementedError(f"operation {operation} is not linear in the seeds")
