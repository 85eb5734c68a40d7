# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""C code of the integration step, generated from the CasADi expressions of the model.

CasADi's code generator supports one number type. Here a nominal value is a ``double`` and a
derivative a ``tangent``, a few vector registers that hold the derivatives along all directions, so
each operation is written once and the nominal value is computed once. That works because the step
is made of sums, products and quotients alone, and a derivative is linear in its seeds: a tangent
is only ever added to a tangent or scaled by a number. ``vectors.h`` defines the tangents.
"""

import casadi as ca

from sphere_nmpc.model.integrator import tangent_step_function

_PLACES = {
    "q": ("y", 0), "momentum": ("y", 4), "u_start": ("u_start", 0), "u_end": ("u_end", 0),
    "h": ("h", 0), "p": ("p", 0), "torques": ("torques", 0), "dxy": ("dxy", 0),
    "q_end": ("y_end", 0), "momentum_end": ("y_end", 4),
    "dq": ("dy", 0), "dmomentum": ("dy", 4), "du_start": ("du_start", 0), "du_end": ("du_end", 0),
    "dh": ("dh", 0),
    "dp": ("dp", 0), "dtorques": ("dtorques", 0), "ddxy": ("ddxy", 0),
    "dq_end": ("dy_end", 0), "dmomentum_end": ("dy_end", 4),
}
"""Array in C, and first index in it, of each argument and result of the step: y holds the
quaternion and the momentum if there is one."""

_BY_KNOTS = ("q", "u_start", "u_end")
_BY_START_AND_KNOTS = ("q", "momentum", "u_start", "u_end", "h")
_BY_PLANT = ("q", "momentum", "p", "torques")
"""What a step is differentiated by: for a solve without and with momentum, for an estimator."""

_SYMBOL = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_TANGENT_NAME = {ca.OP_ADD: "TANGENT_SUM", ca.OP_SUB: "TANGENT_DIFFERENCE"}

_INPUTS = (
    "const double *restrict y, const double *restrict u_start, const double *restrict u_end, "
    "double h, const double *restrict p, const double *restrict torques"
)
_OUTPUTS = "double *restrict dxy, double *restrict y_end"

Operands = list[tuple[str, bool]]
"""Name of each operand, and whether it is a tangent."""


def kernel_source() -> str:
    """Return the C functions of a step: alone and with derivatives, without and with momentum.

    The last one, ``fitted_step``, has the derivatives that an estimator needs.
    """
    return (
        _nominal("nominal_step_undisturbed", tangent_step_function(0, _BY_KNOTS, undisturbed=True))
        + _kernel("tangent_step_undisturbed", "tangent", _BY_KNOTS, undisturbed=True)
        + _nominal("nominal_step_disturbed", tangent_step_function(0, _BY_START_AND_KNOTS))
        + _kernel("tangent_step_disturbed", "wide_tangent", _BY_START_AND_KNOTS)
        + _kernel("fitted_step", "fitted", _BY_PLANT)
    )


def _nominal(name: str, function: ca.Function) -> str:
    return f"static void {name}({_INPUTS}, {_OUTPUTS})\n{{\n{_body(function)}}}\n\n"


def _kernel(name: str, tangent: str, varied: tuple[str, ...], undisturbed: bool = False) -> str:
    function = tangent_step_function(1, varied, undisturbed)
    arrays = dict.fromkeys(_PLACES[f"d{name}"][0] for name in varied)
    seeds = "".join(f", const {tangent} *restrict {array}" for array in arrays)
    tangents = f"{tangent} *restrict ddxy, {tangent} *restrict dy_end"
    return (
        f"static void {name}({_INPUTS}{seeds}, {_OUTPUTS}, {tangents})\n"
        f"{{\n{_body(function)}}}\n\n"
    )


def _without_repetition(function: ca.Function) -> ca.Function:
    """Return the function with common subexpressions, which differentiation repeats, once each."""
    arguments = function.sx_in()
    return ca.Function(
        function.name(), arguments, ca.cse(function.call(arguments)), function.name_in(),
        function.name_out(),
    )


def _body(function: ca.Function) -> str:
    """Translate CasADi's instructions, one statement each."""
    # CasADi reuses its work vector; here every instruction gets a name of its own.
    function = _without_repetition(function)
    arguments, results = function.name_in(), function.name_out()
    seeds = [name for name in arguments if name[0] == "d"]
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
            is_tangent[target] = argument in seeds
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
