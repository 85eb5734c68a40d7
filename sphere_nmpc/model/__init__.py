# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The rolling sphere: parameters, state, equations of motion and their integration."""
