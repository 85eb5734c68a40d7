# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sphere_nmpc.strategy.time_optimal import strategy
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings


@pytest.fixture(autouse=True)
def search_of_any_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a search use its whole effort, however busy the machine is."""
    tuning = TimeOptimalSettings(longest_search=np.inf)
    monkeypatch.setattr(strategy, "TimeOptimalSettings", lambda: tuning)
