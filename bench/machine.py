# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of measured figures, with the machine that they were measured on."""

import json
import os
import platform
import sys
import time
from pathlib import Path
from typing import Any


def machine() -> dict[str, object]:
    """Return what measured figures depend on."""
    return {
        "date": time.strftime("%Y-%m-%d %H:%M"),
        "processors": os.cpu_count(),
        "load_average": [round(load, 1) for load in os.getloadavg()],
        "python": platform.python_version(),
        "command": " ".join(["python", *sys.argv]),
    }


def write_json(path: Path | None, result: dict[str, Any]) -> None:
    """Write the result to the file of ``--json``, if it is given."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=2, default=_plain) + "\n")


def _plain(value: Any) -> object:
    """Return an array as lists, and anything else that JSON does not have as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
