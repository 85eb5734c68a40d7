# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios of runs: the paper's cases, and random ones of kinds that are difficult in other ways.

SciPy is imported where it is used, as it takes long to load.
"""

import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from sphere_nmpc.errors import Description, InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import (
    DEFAULT_START,
    POSITION,
    Vector,
    as_state,
    make_state,
    upright_state,
)
from sphere_sim.scenario.lower_bound import lower_bound
from sphere_sim.world.disturbances import DisturbanceSettings, Push

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

PUSH_COLUMNS = ("push_x", "push_y", "push_time")
"""Columns of scenario files for a push: impulse [N s; world], time [s]."""
DISTURBANCE_COLUMNS = tuple(setting.name for setting in fields(DisturbanceSettings))
"""Columns of scenario files with settings of this name."""
PATH_SPEED_COLUMN = "path_speed"
"""Column of scenario files with this setting of the controller."""


@dataclass(frozen=True, eq=False)
class GivenPath:
    """Places that a scenario gives as its path, shape (P, 2) [m], and the file that has them."""

    places: Vector
    file: pathlib.Path

    @property
    def end(self) -> Vector:
        """The last place as a state, shape (6,); any orientation will do."""
        return upright_state(*self.places[-1].tolist())


@dataclass(frozen=True, eq=False)
class Scenario:
    """Start and goal of a run.

    Attributes
    ----------
    start, goal : ndarray, shape (6,)
        Initial and desired state; the sphere starts at rest.
    seed : int
        Seed of all random numbers of the run.
    extra : dict of str to str
        Further columns of the scenario file, copied to the results.
    given : dict of str to str
        Text of the columns of both states in the file, before normalisation; empty without a
        file.
    push : Push, optional
        Push during the run.
    disturbances : dict of str to float
        Settings of `sphere_sim.world.disturbances.DisturbanceSettings` of this run.
    follows : GivenPath, optional
        Path of the run, at whose end is its goal.
    path_speed : float, optional
        Setting of the controller of this run [m/s].
    map_file : pathlib.Path, optional
        Setting of the floor of this run.
    """

    start: Vector
    goal: Vector
    seed: int = 0
    extra: dict[str, str] = field(default_factory=dict)
    given: dict[str, str] = field(default_factory=dict)
    push: Push | None = None
    disturbances: dict[str, float] = field(default_factory=dict)
    follows: GivenPath | None = None
    path_speed: float | None = None
    map_file: pathlib.Path | None = None

    def floor(self, settings: FloorSettings) -> FloorSettings:
        """Return the settings of the floor of the run."""
        return replace(settings, map_file=str(self.map_file)) if self.map_file else settings

    def course(self, tolerance: float, radius: float) -> Course:
        """Return the course of the run; see `Path.through` for what a path needs."""
        if self.follows is None:
            return Course.of(Goal(as_state(self.goal)))
        return Course.along(*Path.through(self.follows.places, tolerance, radius))

    def lower_bound(self, robot: RobotParameters) -> float:
        """Return a time [s] in which no motion leads from the start to the goal, at rest at both.

        It holds without momentum on a level floor.
        """
        return lower_bound(self.start, self.goal, robot)

    @property
    def optional(self) -> dict[str, float]:
        """Content of the optional columns with numbers, by name, in the order of the columns."""
        push: dict[str, float] = {}
        if self.push is not None:
            values = (*self.push.impulse, self.push.time)
            push = dict(zip(PUSH_COLUMNS, values, strict=True))
        kept = {n: self.disturbances[n] for n in DISTURBANCE_COLUMNS if n in self.disturbances}
        speed = {} if self.path_speed is None else {PATH_SPEED_COLUMN: self.path_speed}
        return push | kept | speed


def _paper_case(start: Sequence[float], goal: Sequence[float]) -> Scenario:
    return Scenario(as_state(start), as_state(goal))


_ORIGIN = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
_ON_THE_CIRCLE = [0.0, 0.0, 0.7071, 0.0, 0.7071, 0.0]

PAPER_CASES: dict[int, Scenario] = {
    1: _paper_case(DEFAULT_START, _ORIGIN),
    2: _paper_case([1.0, 2.0, 0.5, 0.5, 0.5, 0.5], _ON_THE_CIRCLE),
    3: _paper_case([0.0, 0.0, 0.6521, 0.1132, 0.1115, 0.7413], _ORIGIN),
    4: _paper_case([0.0, 0.0, 0.2734, 0.5628, 0.4281, 0.6521], _ON_THE_CIRCLE),
}
"""The four cases of section 4 of the paper, where case 4 has noise and parameter errors."""


Ends = tuple[Vector, Vector]
"""Start and goal."""

_NEAREST, _FARTHEST = 10.0, 60.0
"""Limits of the distance of a far goal [m]."""
_HALF_SIDE = 3.0
"""Half the side of the square of the positions, centred at the origin [m]."""
_ATTEMPTS = 10_000
"""Largest number of attempts to draw a place on a floor."""


def anywhere(rng: np.random.Generator) -> Ends:
    """Return positions uniform in +-3 m and orientations uniform on SO(3)."""
    start, goal = (_state(rng) for _ in range(2))
    return start, goal


def far(rng: np.random.Generator) -> Ends:
    """Return a goal 10 to 60 m away in any direction, orientations uniform on SO(3)."""
    return _away(rng, rng.uniform(_NEAREST, _FARTHEST))


def kilometre(rng: np.random.Generator) -> Ends:
    """Return a goal 1 km away in any direction, orientations uniform on SO(3)."""
    return _away(rng, 1000.0)


def circle(rng: np.random.Generator) -> Ends:
    """Return orientations with the contact point on the circle Gamma (Eq. 16)."""
    start, goal = (make_state(_position(rng), _on_circle(rng)) for _ in range(2))
    return start, goal


def half_turn(rng: np.random.Generator) -> Ends:
    """Return equal positions and orientations that differ by half a turn about any axis."""
    from scipy.spatial.transform import Rotation

    start = _state(rng)
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.pi * axis / np.linalg.norm(axis))
    w, *vector = start[2:]
    return start, make_state(start[:2], _quaternion(turn * Rotation.from_quat([*vector, w])))


def upright(rng: np.random.Generator) -> Ends:
    """Return starts as of `anywhere` and upright goals: turned about the vertical alone."""
    start, position, heading = _state(rng), _position(rng), rng.uniform(-np.pi, np.pi)
    turn = np.array([np.cos(0.5 * heading), 0.0, 0.0, np.sin(0.5 * heading)])
    return start, make_state(position, turn)


def typed(rng: np.random.Generator) -> Ends:
    """Return what a person types: round numbers and symmetric directions.

    Starts at the origin, upright, upside down, on a side or with the contact point on the circle
    Gamma between the rotors; goals at 0 to 10 m straight or diagonally ahead, upright, of
    headings in steps of 15 degrees.
    """
    half = np.sqrt(0.5)
    starts = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (half, 0, half, 0), (half, half, 0, 0),
              (0.5, 0.5, 0.5, 0.5))
    distance = rng.choice([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0])
    direction = rng.choice([-1, 0, 1], size=2)
    heading = np.radians(15.0 * rng.integers(24))
    return make_state((0.0, 0.0), starts[rng.integers(len(starts))]), make_state(
        distance * direction, (np.cos(0.5 * heading), 0.0, 0.0, np.sin(0.5 * heading))
    )


DRAWS: dict[str, Callable[[np.random.Generator], Ends]] = {
    draw.__name__: draw for draw in (anywhere, far, kilometre, circle, half_turn, upright, typed)
}
"""All kinds by name; each takes a generator and returns start and goal."""


def _away(rng: np.random.Generator, distance: float) -> Ends:
    start, bearing = _state(rng), rng.uniform(0.0, 2.0 * np.pi)
    position = start[:2] + distance * np.array([np.cos(bearing), np.sin(bearing)])
    return start, make_state(position, random_quaternion(rng))


def _state(rng: np.random.Generator) -> Vector:
    quaternion = random_quaternion(rng)
    return make_state(_position(rng), quaternion)


def _position(rng: np.random.Generator) -> Vector:
    return rng.uniform(-_HALF_SIDE, _HALF_SIDE, size=2)


def _on_circle(rng: np.random.Generator) -> Vector:
    from scipy.spatial.transform import Rotation

    # The contact point is on Gamma if the body's z axis is horizontal.
    heading, roll = rng.uniform(0.0, 2.0 * np.pi, size=2)
    return _quaternion(Rotation.from_euler("ZYZ", [heading, 0.5 * np.pi, roll]))


def _quaternion(rotation: "Rotation") -> Vector:
    x, y, z, w = rotation.as_quat()
    return np.array([w, x, y, z])


def draw_scenarios(
    number: int, seed: int, kind: str = "anywhere", floor: Floor = Floor.EMPTY
) -> list[Scenario]:
    """Return random scenarios of one of the kinds in `DRAWS`.

    These are anywhere, far, kilometre, circle, half_turn, upright and typed. On a floor the
    positions are uniform over all of it that has the needed clearance; a goal at its start stays
    there. Scenario i depends on the seed alone, not on `number`.
    `InvalidParameterError` is raised if there is no such kind, or for a floor without room for the
    sphere.
    """
    if kind not in DRAWS:
        raise InvalidParameterError("kind", kind, " or ".join(DRAWS))
    scenarios = []
    for i in range(number):
        rng = np.random.default_rng([seed, i])
        start, goal = DRAWS[kind](rng)
        of_run = int(rng.integers(2**31))
        if not floor.is_empty:
            in_place = np.array_equal(start[POSITION], goal[POSITION])
            start[POSITION] = _clear_place(rng, floor)
            goal[POSITION] = start[POSITION] if in_place else _clear_place(rng, floor)
        scenarios.append(Scenario(start, goal, seed=of_run))
    return scenarios


def _clear_place(rng: np.random.Generator, floor: Floor) -> Vector:
    """Return a place [m] where the sphere has its clearance."""
    corners = floor.corner_distances
    # A place is no farther from its nearest corner than half the diagonal of a cell.
    least = floor.needed - np.sqrt(0.5) * floor.fine.resolution
    rows, columns = np.nonzero(corners >= least)
    for _ in range(_ATTEMPTS if rows.size else 0):
        nearest = rng.integers(rows.size)
        local = np.array([columns[nearest], rows[nearest]]) + rng.uniform(-0.5, 0.5, size=2)
        place = floor.fine.world(local)
        if floor.distances(place[None])[0] >= floor.needed:
            return place
    raise InvalidParameterError(
        "map", Description(f"no place that is {floor.needed:g} m away from what is occupied"),
        "room for the sphere",
    )
