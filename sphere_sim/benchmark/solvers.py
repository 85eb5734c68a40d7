# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Benchmarked solvers by the names under which they are reported."""

from sphere_sim.benchmark.benchmarked_solver import Maker
from sphere_sim.benchmark.do_mpc_solver import DoMpc
from sphere_sim.benchmark.nlp_solvers import GeneratedSqp, Slsqp, ipopt, ipopt_compiled
from sphere_sim.benchmark.numpy_slsqp import NumpySlsqp
from sphere_sim.benchmark.own_solvers import AlgorithmOne, BothSigns
from sphere_sim.benchmark.report import ALGORITHM_1, PLAN_KEEPING

IPOPT = "casadi ipopt"

QUICK: dict[str, Maker] = {
    ALGORITHM_1: AlgorithmOne,
    PLAN_KEEPING: BothSigns,
    "scipy slsqp (casadi cost)": lambda: Slsqp(exact_gradient=False),
    IPOPT: ipopt,
}
"""Solvers whose set-up takes no compilation."""

ALL: dict[str, Maker] = {
    **QUICK,
    "scipy slsqp (numpy)": NumpySlsqp,
    "scipy slsqp (casadi cost and gradient)": lambda: Slsqp(exact_gradient=True),
    "casadi ipopt (compiled)": ipopt_compiled,
    "casadi sqpmethod+qrqp (generated C)": GeneratedSqp,
    "do-mpc": DoMpc,
}
