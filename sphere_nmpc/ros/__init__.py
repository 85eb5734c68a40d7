# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller as a ROS 2 node, and what all nodes of the package share."""

import os

# Read when numpy is first loaded, which a node does after this. Matrices of five rows gain nothing
# from threads, and threads that wait for work take the processor from the control loop.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
