# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""All that a recording shows of a robot, and the parameters of nodes that follow from it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.errors import Description, InvalidInputError, InvalidParameterError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.quantities import quantities
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.identification.bag import Recorded
from sphere_sim.identification.drives import Drives, identified_drives
from sphere_sim.identification.inertial import Mounted, Readings, Value, identified_mounting
from sphere_sim.identification.inside import Balance, identified_place, track_of
from sphere_sim.identification.robot_file import (
    CHANGED,
    Entry,
    deviations_of,
    robot_entries,
    with_constants,
)
from sphere_sim.identification.rolled_radius import rolled_radius
from sphere_sim.identification.rolling import OFFSET, BatchFit, Estimate

_TRACK_STEP = 5e-3
"""Spacing of the motion beside which an IMU is read [s; for the robot of Table 1]."""
_MARGIN = 0.05
"""Largest offset of the stamps of an IMU [s]."""
_GROUPS = 8
"""Groups of pieces, each of which is left out once to find the deviations of a mounting."""
_PASSES = 2
"""Runs of the odometry, the second with the constants of the first."""
_FEWEST = 4
"""Pieces of motion from which on half of them checks the other half."""
_LASTING = 1.2
"""What is left over its part that differs between neighbours from which on that is said [-]."""
_FEW_OUTLIERS = 1e-3
"""Share of the poses that are left out also without any that is wrong [-]."""
_LONGEST_LAG = 0.05
"""Largest lag that the controller takes [s]."""
_LEAST_RATE = 0.02
"""Angular velocity below which there is no motion that shows constants [rad/s]."""
_LIMITS = ("max_rotor_acceleration", "max_rotor_speed")
_NOISES = ("pose_position_noise", "pose_orientation_noise")
AS_GIVEN = "not seen, as given"


@dataclass(frozen=True)
class Given:
    """What is known before: robot, controller and IMU."""

    robot: RobotParameters = field(default_factory=RobotParameters)
    controller: ControllerSettings = field(default_factory=ControllerSettings)
    imu: ImuSettings = field(default_factory=ImuSettings)


@dataclass(frozen=True)
class Row:
    """Line of the table: numbers with their standard deviations, and those given.

    Without deviations the value is not seen, and the one given; it may have a remark.
    """

    name: str
    unit: str
    value: tuple[float, ...]
    deviation: tuple[float, ...] = ()
    given: tuple[float, ...] = ()
    remark: str = ""


@dataclass
class Identified:
    """Result: robot, table, parameters of nodes by their sections, and what the check found."""

    given: Given
    robot: RobotParameters
    rows: list[Row] = field(default_factory=list)
    notes: dict[str, str] = field(default_factory=dict)
    controller: dict[str, Entry] = field(default_factory=dict)
    odometry: dict[str, Entry] = field(default_factory=dict)
    check: str = ""

    @property
    def sections(self) -> dict[str, dict[str, Entry]]:
        """Sections of the file of parameters, by nodes."""
        found = {
            "/**": robot_entries(self.robot, self.notes),
            "/**/controller": self.controller, "/**/odometry": self.odometry,
        }
        return {node: entries for node, entries in found.items() if entries}

    @property
    def summary(self) -> str:
        """How much was seen, and the check, in a line."""
        seen = sum(bool(row.deviation) for row in self.rows)
        unseen = ", ".join(row.name for row in self.rows if not row.deviation)
        unknown = f"; not seen, as given: {unseen}" if unseen else ""
        return f"{seen} of {len(self.rows)} identified{unknown}{self.check}"

    def add(
        self, name: str, unit: str, value: ArrayLike, deviation: ArrayLike | None,
        given: ArrayLike | None = None, remark: str = "",
    ) -> None:
        """Add a row; without a deviation what is given is kept."""
        def numbers(one: ArrayLike | None) -> tuple[float, ...]:
            return () if one is None else tuple(np.ravel(one).tolist())

        kept = numbers(value if deviation is not None else given)
        self.rows.append(Row(name, unit, kept, numbers(deviation), numbers(given), remark))

    def add_parameter(
        self, name: str, value: ArrayLike = 0.0, deviation: ArrayLike | None = None,
        remark: str = "",
    ) -> None:
        """Add the row of a parameter, whose field has its unit and what is given."""
        group, _, field_name = name.rpartition(".")
        given = {"robot": self.given.robot, "imu": self.given.imu}
        settings = given.get(group, self.given.controller)
        unit = quantities(settings)[field_name].unit.removeprefix("-")
        self.add(name, unit, value, deviation, getattr(settings, field_name), remark)


def identified(
    recorded: Recorded, given: Given, distance: float | None = None, tape: float = 1e-3,
    progress: Callable[[str], None] = lambda text: None,
) -> Identified:
    """Return what a recording shows of a robot.

    `distance` [m] is the length of a straight way that was measured, with a deviation of `tape`
    [m]; poses are then those of an odometry. `InvalidInputError` is raised where the recording
    has not what is needed.
    """
    found = Identified(given, given.robot)
    late, fastest = 0.0, float(np.max(np.abs(recorded.rotor_speeds.values), initial=0.0))
    if distance is not None:
        _of_distance(found, recorded, distance, tape)
    elif not recorded.rotor_speeds:
        raise InvalidInputError(
            "rotor speeds", Description("none"),
            "those on joint_states [rad/s], from which the motion follows",
        )
    elif fastest * given.robot.lumped.input_gain < _LEAST_RATE:
        raise InvalidInputError(
            "motion", Description(f"rotor speeds up to {fastest:.2g} rad/s"),
            "some that roll the sphere to all sides, as of examples/identification_motion.py",
        )
    elif recorded.are_outside:
        late = _of_poses(found, recorded, progress)
    elif recorded.readings is not None:
        _of_inside(found, recorded, recorded.readings, progress)
    else:
        raise InvalidInputError(
            "poses", Description("none from outside, and no readings of an IMU"),
            "those of a camera or motion capture, or imu",
        )
    drives, why = None, "no commands in the bag"
    if recorded.commands is not None and recorded.rotor_speeds:
        progress("drives")
        drives = identified_drives(recorded.commands, recorded.rotor_speeds)
        why = "rotor speeds do not follow the commands"
    if drives is not None:
        _of_drives(found, drives, late)
    else:
        found.add("lag of the drives", "s", 0.0, None, given.controller.drive_lag, why)
        for name in _LIMITS:
            found.add_parameter(f"robot.{name}", remark=why)
    return found


def _of_poses(found: Identified, recorded: Recorded, progress: Callable[[str], None]) -> float:
    """Add what poses from outside show; return by how much their stamps are late [s]."""
    fit = BatchFit(recorded, found.given.robot)
    count = len(fit.pieces)
    if count < _FEWEST:
        raise InvalidInputError(
            "recording", Description(f"{count} pieces of {fit.length:.2g} s"),
            f"{_FEWEST} or more with poses and rotor speeds",
        )
    whole = list(range(count))
    progress(f"constants: half of {count} pieces, of {fit.length:.2g} s")
    half = fit.fitted(whole[::2])
    before, after = fit.left(whole[1::2], fit.given), fit.left(whole[1::2], half)
    progress("constants: all pieces")
    estimate = fit.fitted(whole, half)
    found.check = (
        f"; half of the bag predicts the other half within {_errors(after)}, the given robot "
        f"within {_errors(before)}"
    )
    if estimate.left_out > _FEW_OUTLIERS * recorded.times.size:
        found.check += f"; {estimate.left_out} of {recorded.times.size} poses are outliers"
    if estimate.lasting > _LASTING:
        found.check += (
            "; what is left lasts from pose to pose: no noise of poses, but friction, slip, "
            "smoothing or encoders"
        )
    _add_constants(found, fit, estimate)
    # Of a median, which is 1.25 times that of a mean.
    noise = 1.25 * estimate.noise / math.sqrt(recorded.times.size) / np.sqrt((4.0, 6.0))
    for name, value, deviation in zip(_NOISES, estimate.noise, noise, strict=True):
        found.add_parameter(name, value, deviation)
        found.controller[name] = Entry(_rounded(value, 3), "what the motion leaves of the poses")
    if recorded.readings is not None:
        try:
            _add_mounting(found, fit, estimate, recorded.readings, progress)
        except InvalidInputError as error:
            progress(f"IMU: {error}")
            for name in ("imu.position", "imu.orientation"):
                found.add_parameter(name)
    return -float(estimate.common[OFFSET])


def _errors(left: Vector) -> str:
    return f"{1e3 * left[0]:.3g} mm and {1e3 * left[1]:.3g} mrad"


def _add_constants(found: Identified, fit: BatchFit, estimate: Estimate) -> None:
    """Add constants, offset of the stamps, slope and centre of mass."""
    shown = estimate.seen[:4] * fit.nominal
    covariance = estimate.covariance[:4, :4] * np.outer(shown, shown)
    _change_robot(found, fit.constants(estimate.common), covariance)
    deviations = estimate.deviations
    seen = deviations[OFFSET] if estimate.seen[OFFSET] else None
    found.add("offset of pose stamps", "s", -estimate.common[OFFSET], seen, 0.0,
              "late against joint_states")
    torque = found.robot.rotor_axial_inertia / (found.robot.total_mass * GRAVITY)
    slope = np.degrees(torque / found.robot.shell_radius)
    found.add("slope along x and y", "deg", slope * estimate.common[[6, 5]] * (1.0, -1.0),
              slope * deviations[[6, 5]], remark="of the floor, downwards")
    found.add("centre of mass", "mm", 1e3 * torque * estimate.common[7:],
              1e3 * torque * deviations[7:], remark="beside the centre of the shell")


def _change_robot(found: Identified, constants: Vector, covariance: Vector) -> None:
    """Add constants with a covariance, (4, 4), zero of what is not seen, and change the robot."""
    given = found.given.robot
    names, nominal = ("robot.shell_radius", "c1", "r1", "r3"), given.lumped.as_array()
    for i, name in enumerate(names):
        deviation = math.sqrt(covariance[i, i]) or None
        found.add(name, "" if i else "m", constants[i], deviation, nominal[i])
    found.robot = _robot(given, constants)
    deviations = deviations_of(given, constants, covariance)
    for name in ("shell_radius", *CHANGED):
        found.notes[name] = f"+- {deviations[name]:.2g}" if deviations[name] else AS_GIVEN


def _robot(given: RobotParameters, constants: Vector) -> RobotParameters:
    """Return a robot with these constants and the given masses."""
    try:
        return with_constants(given, LumpedConstants(*constants.tolist()))
    except InvalidParameterError as error:
        raise InvalidInputError(
            "constants", Description(", ".join(f"{one:.4g}" for one in constants)),
            f"those of a robot with the given masses ({error})",
        ) from None


def _of_inside(
    found: Identified, recorded: Recorded, readings: Readings, progress: Callable[[str], None]
) -> None:
    """Add what an IMU and rotor speeds show without poses from outside."""
    given = found.given
    robot, scale = given.robot, given.imu.gyro_scale
    length = EstimatorSettings().of(RobotUnits.of(robot)).longest
    for turn in range(_PASSES):
        progress(f"constants by the odometry: {turn + 1} of {_PASSES}")
        track = track_of(readings, recorded.rotor_speeds, robot, given.imu, length)
        balance = Balance(track, recorded.rotor_speeds, scale)
        whole = list(range(len(balance.parts)))
        inside = balance.fitted(whole, robot.lumped)
        radius, place = identified_place(readings, inside, given.imu, scale)
        constants: Vector = np.concatenate((radius[0], inside.constants))
        covariance = np.zeros((4, 4))
        covariance[0, 0], covariance[1:, 1:] = radius[1][0] ** 2, inside.covariance
        robot = _robot(given.robot, constants)
    half = balance.fitted(whole[::2], given.robot.lumped).constants
    after = balance.left(whole[1::2], LumpedConstants(constants[0], *half.tolist()))
    before = balance.left(whole[1::2], given.robot.lumped)
    found.check = (
        "; half of the bag predicts the angular velocity in the other half within "
        f"{after:.2g} rad/s, the given robot within {before:.2g} rad/s"
    )
    _change_robot(found, constants, covariance)
    found.add("offset of IMU stamps", "s", *inside.offset, 0.0, "late against joint_states")
    _add_place(found, place)
    for name in ("imu.orientation", *_NOISES):
        found.add_parameter(name, remark="takes poses from outside")


def _add_place(found: Identified, place: Value) -> None:
    found.add_parameter("imu.position", *place)
    found.odometry["imu.position"] = Entry(
        tuple(_rounded(one, 5) for one in place[0]), f"+- {_list(place[1])} m"
    )


def _add_mounting(
    found: Identified, fit: BatchFit, estimate: Estimate, readings: Readings,
    progress: Callable[[str], None],
) -> None:
    """Add what readings of an IMU show beside the poses, with deviations by leaving pieces out."""
    step = _TRACK_STEP * RobotUnits.of(found.given.robot).time

    def mounted(chosen: list[int], at: Estimate, larger: float = 0.0) -> Mounted:
        radius = float(fit.constants(at.common)[0]) + larger
        return identified_mounting(readings, fit.track(chosen, at, step), radius, _MARGIN)

    whole = list(range(len(fit.pieces)))
    best = mounted(whole, estimate)
    others = []
    groups = min(_GROUPS, len(whole))
    for group in range(groups):
        progress(f"IMU: {group + 1} of {groups}")
        chosen = [k for k in whole if k % groups != group]
        others.append(mounted(chosen, fit.fitted(chosen, estimate)))
    # The place takes the error of the radius.
    larger = mounted(whole, estimate, float(fit.nominal[0] * estimate.deviations[0]))
    _add_imu(found, best.with_scatter(others, larger))


def _add_imu(found: Identified, imu: Mounted) -> None:
    """Add the rows and parameters of an IMU."""
    found.add("offset of IMU stamps", "s", *imu.offset, 0.0, "late against joint_states")
    turn = imu.orientation
    _add_place(found, imu.position)
    found.add_parameter(
        "imu.orientation", *turn, "deviation: rotation about the axes of the body [rad]"
    )
    found.add("gyro bias", "rad/s", *imu.gyro_bias)
    found.add("gyro scale", "", *imu.gyro_scale, remark="above 1")
    found.add("accelerometer bias", "m/s^2", *imu.accelerometer_bias)
    found.add("accelerometer scale", "", *imu.accelerometer_scale, remark="above 1")
    found.odometry["imu.orientation"] = Entry(
        tuple(_rounded(one, 7) for one in turn[0]), f"+- {_list(turn[1])} rad about body axes"
    )
    where = "at rest" if imu.at_rest else "in motion"
    for name, value in zip(("imu.gyro_noise", "imu.accelerometer_noise"), imu.noises, strict=True):
        found.add_parameter(name, value, value / math.sqrt(6.0 * imu.count), where)
        found.odometry[name] = Entry(_rounded(value, 3), where)


def _of_distance(found: Identified, recorded: Recorded, distance: float, tape: float) -> None:
    """Add the radius by a straight way that was measured, and that odometry has estimated."""
    if not recorded.times.size:
        raise InvalidInputError("poses", Description("none"), "those of an odometry")
    height = recorded.height
    radius, rolled = rolled_radius(recorded.times, recorded.states[:, :2], height, distance)
    deviation = tape * height / rolled
    found.add("robot.shell_radius", "m", radius, deviation, height,
              f"{distance:g} m measured, {rolled:.4f} m estimated")
    found.robot = replace(found.robot, shell_radius=_rounded(radius, 5))
    found.notes["shell_radius"] = f"+- {deviation:.2g}, by a way of {distance:g} m"


def _of_drives(found: Identified, drives: Drives, late: float) -> None:
    """Add lag and limits of the drives; `late` is by how much stamps of poses are [s]."""
    lag, deviation = drives.lag
    found.add("lag of the drives", "s", lag, deviation, remark="behind the commands")
    whole = min(max(lag + late, 0.0), _LONGEST_LAG)
    found.controller = {
        "drive_lag": Entry(_rounded(whole, 4), f"+- {deviation:.2g}, with the pose stamps'"),
        **found.controller,
    }
    limits = drives.acceleration, drives.speed
    for name, limit, attained in zip(_LIMITS, limits, drives.attained, strict=True):
        if limit is None:
            found.add_parameter(f"robot.{name}", remark=f"not reached up to {attained:.4g}")
            found.notes[name] = AS_GIVEN
            continue
        found.add_parameter(f"robot.{name}", *limit, "as attained")
        # Downwards, as plans must not exceed what is attained.
        value = math.floor(limit[0] * 10.0) / 10.0
        found.robot = replace(found.robot, **{name: value})
        found.notes[name] = f"+- {limit[1]:.2g}, as attained"


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _list(values: Sequence[float] | Vector) -> str:
    return ", ".join(f"{one:.2g}" for one in values)
