# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The tests of the viewer share a helper beside them."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
