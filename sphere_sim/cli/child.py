# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``python -m sphere_sim.cli.child PARENT VERB ...``: a verb that ends with its parent process."""

import sys

from sphere_sim.cli.main import main
from sphere_sim.ros.session.parent import end_with_parent

if __name__ == "__main__":
    end_with_parent(int(sys.argv.pop(1)))
    sys.exit(main())
