# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller as a ROS 2 node, and modules that all nodes of the package share."""

from sphere_nmpc.process.library_threads import limit_library_threads

# Here, as the libraries read the limit when a node imports numpy after this.
limit_library_threads()
