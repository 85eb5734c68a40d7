# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A node is served until a condition holds, or until the wait is given up."""

import pytest

from sphere_sim.ros.session.serving import serve_until

FOREVER = 1e9


@pytest.mark.parametrize("needed", [0, 1, 3])
def test_node_is_served_no_longer_than_the_condition_needs(needed) -> None:
    served: list[int] = []
    assert serve_until(lambda: served.append(1), lambda: len(served) >= needed, FOREVER)
    assert len(served) == needed


def test_condition_is_checked_even_if_no_time_is_left() -> None:
    assert serve_until(pytest.fail, lambda: True, -1.0)
    assert not serve_until(pytest.fail, lambda: False, -1.0)
