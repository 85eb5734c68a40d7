# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sets of goals: members, the nearest of them, and goals that move."""

import numpy as np
import pytest

from sphere_nmpc.model import rotation
from sphere_nmpc.model.goal import Goal, GoalSequence, Orientation, moved
from sphere_nmpc.model.state import (
    POSITION,
    QUATERNION,
    Vector,
    make_state,
    state_error,
    upright_state,
)


def drawn(seed: int) -> tuple[Vector, Vector]:
    """Return a pose and a state, shape (6,) each."""
    rng = np.random.default_rng(seed)
    pose, state = (
        make_state(rng.normal(size=2), rotation.random_quaternion(rng)) for _ in range(2)
    )
    return pose, state


def is_member(kind: Orientation, pose: Vector, other: Vector) -> bool:
    """Return whether a pose is in the set of another one, by the geometry of what is demanded."""
    same = {
        Orientation.FULL: rotation.angle_between(pose[QUATERNION], other[QUATERNION]) < 1e-7,
        Orientation.ANY_HEADING: np.allclose(
            rotation.vertical(pose[QUATERNION]), rotation.vertical(other[QUATERNION]), atol=1e-9
        ),
        Orientation.ANY: True,
    }
    return np.array_equal(pose[POSITION], other[POSITION]) and bool(same[kind])


@pytest.mark.parametrize("kind", Orientation)
@pytest.mark.parametrize("seed", range(5))
def test_nearest_member_is_in_the_set_and_no_drawn_one_is_nearer(kind, seed) -> None:
    pose, state = drawn(seed)
    nearest = kind.nearest(pose, state)
    assert is_member(kind, pose, nearest)
    members = kind.draw(np.random.default_rng(seed), pose, 200).T
    assert len(members) == (1 if kind is Orientation.FULL else 200)
    assert all(is_member(kind, pose, member) for member in members)
    distances = [state_error(state, member) for member in members]
    assert state_error(state, nearest) <= min(distances) + 1e-12
    # A member is nearest to itself.
    assert state_error(members[0], kind.nearest(pose, members[0])) < 1e-9


@pytest.mark.parametrize("kind", Orientation)
def test_nearest_members_of_many_states_are_those_of_each(kind) -> None:
    pose = drawn(3)[0]
    over = rotation.product(np.array([0.0, 1.0, 0.0, 0.0]), pose[QUATERNION])
    states = np.array([*(drawn(seed)[1] for seed in range(20)), make_state((1.0, 2.0), over)])
    expected = [kind.nearest(pose, state) for state in states]
    np.testing.assert_allclose(kind.nearest_of(pose, states), expected, atol=1e-12)
    assert kind.nearest_of(pose, states[:0]).shape == (0, 6)


def test_upside_down_all_headings_are_as_near() -> None:
    pose, turned = upright_state(0.0, 0.0, 0.7), make_state((0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    found = Orientation.ANY_HEADING.nearest(pose, turned)
    assert state_error(turned, found) == pytest.approx(np.sqrt(2.0))


def test_goals_are_equal_in_what_they_demand() -> None:
    (pose, state), anywhere = drawn(1), Orientation.ANY
    turned = np.concatenate((pose[POSITION], state[QUATERNION]))
    assert Goal(pose, anywhere).equals(Goal(turned, anywhere))
    assert not Goal(pose).equals(Goal(turned))
    assert not Goal(pose).equals(Goal(pose, anywhere))
    assert not GoalSequence((Goal(pose),)).lists_same(GoalSequence((Goal(pose), Goal(pose))))


def test_goal_moves_at_its_rate() -> None:
    pose, _ = drawn(2)
    rate = np.array([0.3, -0.1, 0.2, -0.4, 0.5])
    later = Goal(pose, rate=rate, since=2.0).at(4.0)
    np.testing.assert_allclose(later[POSITION], pose[POSITION] + 2.0 * rate[:2])
    angle = rotation.angle_between(pose[QUATERNION], later[QUATERNION])
    assert angle == pytest.approx(2.0 * np.linalg.norm(rate[2:]))
    assert state_error(moved(later, rate, -2.0), pose) < 1e-12
