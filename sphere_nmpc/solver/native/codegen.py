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

_NOMINAL_INPUTS = 5
"""q, u_start, u_end, h, p come first in `tangent_step_function`; the seeds follow."""

_SYMBOL = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_TANGENT_NAME = {ca.OP_ADD: "TANGENT_SUM", ca.OP_SUB: "TANGENT_DIFFERENCE"}

_INPUTS = (
    "const double *restrict q, const double *restrict u_start, const double *restrict u_end, "
    "double h, const double *restrict p"
)
_SEEDS = (
    "const tangent *restrict dq, const tangent *restrict du_start, const tangent *restrict du_end"
)
_OUTPUTS = "double *restrict dxy, double *restrict q_end"
_TANGENTS = "tangent *restrict ddxy, tangent *restrict dq_end"

Operands = list[tuple[str, bool]]
"""Name of each operand, and whether it is a tangent."""


def kernel_source() -> str:
    """Return the C functions ``nominal_step`` and ``tangent_step``."""
    value = _without_repetition(tangent_step_function(0))
    both = _without_repetition(tangent_step_function(1))
    return (
        f"static void nominal_step({_INPUTS}, {_OUTPUTS})\n{{\n{_body(value)}}}\n\n"
        f"static void tangent_step({_INPUTS}, {_SEEDS}, {_OUTPUTS}, {_TANGENTS})\n"
        f"{{\n{_body(both)}}}\n"
    )


def _without_repetition(function: ca.Function) -> ca.Function:
    """Return the function with common subexpressions, which differentiation repeats, once each."""
    arguments = function.sx_in()
    return ca.Function(function.name(), arguments, ca.cse(function.call(arguments)))


def _body(function: ca.Function) -> str:
    """Translate CasADi's instructions, one statement each."""
    # CasADi reuses its work vector; here every instruction gets a name of its own.
    names: dict[int, str] = {}
    is_tangent: dict[int, bool] = {}
    lines: list[str] = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            result = ("dxy", "q_end", "ddxy", "dq_end")[targets[0]]
            lines.append(f"{result}[{targets[1]}] = {names[sources[0]]};")
            continue
        target = targets[0]
        name = f"a{k}"
        if operation == ca.OP_INPUT:
            is_tangent[target] = sources[0] >= _NOMINAL_INPUTS
            lines.append(_read(name, sources[0], sources[1]))
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


def _read(name: str, argument: int, index: int) -> str:
    source = ("q", "u_start", "u_end", "h", "p", "dq", "du_start", "du_end")[argument]
    place = source if source == "h" else f"{source}[{index}]"
    if argument >= _NOMINAL_INPUTS:
        return f"TANGENT_COPY({name}, {place})"
    return f"const double {name} = {place};"


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
