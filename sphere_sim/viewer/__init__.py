# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The sphere in the browser: a scene, plots and controls, fed alike by topics and by a bag."""
