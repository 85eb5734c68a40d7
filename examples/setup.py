# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Package with a strategy and a plant of one's own, which sphere_nmpc finds by their names.

``pip install --no-build-isolation ./examples``; then ``--strategy roll_to --plant lagging``.
"""

from setuptools import setup

setup(
    name="own_sphere",
    version="1.0",
    py_modules=["own_strategy", "own_plant"],
    entry_points={
        "sphere_nmpc.strategies": ["roll_to = own_strategy:RollTo"],
        "sphere_nmpc.plants": ["lagging = own_plant:Lagging"],
    },
)
