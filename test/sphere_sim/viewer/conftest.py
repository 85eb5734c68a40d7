# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Import path for the helper modules of the viewer's tests."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
