# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node: a sphere with two rotors, its drives and its clock.

publishes   pose, odom, joint_states, /clock unless it runs on the system clock, /diagnostics
subscribes  rotor_trajectory, rotor_commands
services    ~/reset, ~/pause, ~/step, ~/push where the plant can be pushed
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.executors import Executor
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_nmpc.ros.conversions import BODY_FRAME
from sphere_nmpc.ros.diagnostics import OK, WARN, Diagnostics
from sphere_nmpc.ros.lifetime import LivingNode, run
from sphere_nmpc.ros.parameters import DeclaredSettings, warn_of_unknown
from sphere_nmpc.ros.scheduling import SchedulingSettings
from sphere_nmpc.ros.watch import Watch
from sphere_sim.ros.simulator.command_intake import CommandIntake
from sphere_sim.ros.simulator.world_publisher import WorldPublisher
from sphere_sim.world.clock import Timekeeper
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import PushSettings, SimulatorSettings
from sphere_sim.world.simulator import NANOSECONDS, Simulator

_REPEAT_EVERY = 0.2
"""Wall time between two repetitions of an instant at which time stands still [s]."""
_SERVE_EVERY = 2e-3
"""Wall time between two looks at the middleware [s]; each look costs some 0.2 ms."""
_WORTH_WAITING = 5e-4
"""Time to the next instant that is waited for in the middleware rather than asleep [s]."""
_SLOW = 0.95
"""Share of the wanted pace below which the machine counts as too slow."""

_LISTENERS_BEHIND = 1.0
"""Longest wait of a pause for those who listen [s, wall]."""
_LIFELIKE = 2.0
"""Real-time factor up to which the node may run before others."""
_CLOCK_JUMP = 1_000_000_000
"""How far somebody has to set the system clock for the stamps to follow [ns]."""


class SimulatorNode(LivingNode):
    """Advance a `Simulator` in step with the wall clock or with the controller.

    Parameters
    ----------
    parameter_overrides : list of Parameter, optional
        As given on a command line; for use within a program.
    """

    lean = True

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__(
            "simulator",
            parameter_overrides=parameter_overrides,
            automatically_declare_parameters_from_overrides=True,
        )
        declared = DeclaredSettings(self, SimulatorSettings(), on_change=self._change)
        robot = DeclaredSettings(self, RobotParameters(), prefix="robot")
        body = DeclaredSettings(self, RigidBodySettings(), prefix="rigid_body")
        pushing = DeclaredSettings(self, PushSettings())
        self._scheduling = DeclaredSettings(self, SchedulingSettings())
        parts = (declared, robot, body, pushing, self._scheduling)
        warn_of_unknown(self, [name for part in parts for name in part.names])
        settings = self._settings = declared.settings
        start = as_state(settings.initial_state)
        plant = make_plant(settings.plant, robot.settings, start, body.settings)
        self.simulator = Simulator(settings, robot.settings, plant)
        self._pushing = pushing
        self._time = Timekeeper(
            round(NANOSECONDS / self._settings.pose_rate),
            round(NANOSECONDS * self._settings.sample_period),
            self._settings.real_time_factor,
            self._settings.lockstep,
            self._settings.lockstep_timeout,
            self._settings.start_paused,
            keeps_up=settings.is_on_system_clock,
        )
        self._epoch = self._set_at = 0
        self._faults = FaultLog(lambda line: self.get_logger().warning(line))
        self._watch = Watch(self, self._faults)
        prefix = settings.frame_prefix or f"{self.get_namespace().strip('/')}/".lstrip("/")
        self._world = WorldPublisher(
            self, robot.settings.shell_radius, prefix + BODY_FRAME,
            clocked=not settings.is_on_system_clock,
        )
        self._intake = CommandIntake(
            self, self.simulator, robot.settings.max_rotor_speed,
            self._settings.command_timeout, self._faults, self._settings.lockstep,
            lambda stamp: self._time.answer(stamp, time.monotonic()), lambda: self._epoch,
        )
        self._offers = [
            self.create_service(Trigger, "~/reset", self._reset),
            self.create_service(SetBool, "~/pause", self._pause),
            self.create_service(Trigger, "~/step", self._step),
        ]
        if isinstance(plant, RigidBodyPlant):
            self._offers.append(self.create_service(Trigger, "~/push", self._push))
        self._diagnostics = Diagnostics(
            self, lambda: self._epoch + self.simulator.now,
            {"clock": self._report_clock, "commands": self._report_commands},
        )
        self._partner = False
        self._served = self._told = time.monotonic()
        self._begin()

    @property
    def thread_priority(self) -> int:
        """As set, while time passes as on the wall; faster, one processor would not suffice."""
        settings = self._settings
        lifelike = not settings.lockstep and 0.0 < settings.real_time_factor <= _LIFELIKE
        return self._scheduling.settings.thread_priority if lifelike else 0

    def work(self, executor: Executor) -> None:
        """Advance to the next instant if it is due, and serve the graph now and then."""
        wall = time.monotonic()
        timeouts = self._time.timeouts
        wait = self._time.wait(self.simulator.now, wall, self._partner)
        if self._time.timeouts > timeouts:
            self._tell_timeout()
        if wait <= 0.0:
            self._advance()
            wait = 0.0 if self._time.awaited is None else _REPEAT_EVERY
        self._serve(executor, min(wait, _REPEAT_EVERY))
        if wait >= _REPEAT_EVERY and time.monotonic() > self._told + _REPEAT_EVERY:
            self._look_for_partner()
            self._world.repeat()
            self._told = time.monotonic()

    def _begin(self) -> None:
        wall = time.monotonic()
        self._time.achieved(0, wall)
        if self._settings.is_on_system_clock:
            self._set_epoch(time.time_ns() - self.simulator.now)
        self._world.publish(self.simulator)
        if not self._time.paused:
            self._time.resume(0, wall)

    def _set_epoch(self, epoch: int) -> None:
        self._epoch = self._world.epoch = epoch
        self._set_at = time.time_ns() - time.monotonic_ns()

    def _follow_system_clock(self) -> None:
        """Move the stamps along when somebody sets the system clock."""
        jump = time.time_ns() - time.monotonic_ns() - self._set_at
        if self._settings.is_on_system_clock and abs(jump) > _CLOCK_JUMP:
            self._set_epoch(self._epoch + jump)
            self._faults.report(
                "system clock jumped", f"given a jump of {jump * 1e-9:.3f} s, expected a clock "
                "that is slewed; stamps jump with it",
            )

    def _advance(self) -> None:
        instant = self._time.due(self.simulator.now, time.monotonic())
        self.simulator.advance_to(instant)
        self._follow_system_clock()
        self._time.ran(instant, time.monotonic())
        self._world.publish(self.simulator)
        self._told = time.monotonic()

    def _serve(self, executor: Executor, wait: float) -> None:
        if wait > _WORTH_WAITING:
            executor.spin_once(timeout_sec=wait)
            heard = -1  # there may be more
        elif time.monotonic() > self._served + _SERVE_EVERY:
            heard = -1
        else:
            time.sleep(max(0.0, wait))
            return
        # At a high control rate several commands come between two instants: the newest counts.
        while self._intake.heard != heard:
            heard = self._intake.heard
            executor.spin_once(timeout_sec=0.0)
        self._served = time.monotonic()

    def _look_for_partner(self) -> None:
        self._partner = self._partner or self.count_publishers("rotor_trajectory") > 0
        if self._time.awaited is not None and not self._partner:
            self._faults.report(
                "lockstep", "given no publisher of rotor_trajectory, expected one; time waits"
            )

    def _tell_timeout(self) -> None:
        self._faults.report(
            "lockstep time-out",
            f"given no rotor_trajectory for t = {self.simulator.time:.3f} s, expected one within "
            f"{self._settings.lockstep_timeout:g} s; time goes on without it",
        )

    def _change(self, settings: SimulatorSettings) -> None:
        if settings.real_time_factor != self._settings.real_time_factor:
            now = self.simulator.now
            self._time.set_pace(settings.real_time_factor, now, time.monotonic())
        self._settings = settings
        self.simulator.change(settings)

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.simulator.reset()
        self._world.publish(self.simulator)
        response.success = True
        response.message = f"at the start again, at t = {self.simulator.time:.3f} s"
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._settings.is_on_system_clock:
            response.message = "given clock: system, which nobody can stop, expected simulated"
            return response
        if request.data:
            self._time.pause()
            self._world.flush(_LISTENERS_BEHIND)
        elif self._time.paused:
            self._time.resume(self.simulator.now, time.monotonic())
            self._world.repeat()
        response.success = True
        state = "paused" if request.data else "running"
        response.message = f"{state} at t = {self.simulator.time:.3f} s"
        return response

    def _step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._time.paused
        if not self._time.paused:
            response.message = "given a running simulator, expected a paused one"
            return response
        until = self._time.step(self.simulator.now, time.monotonic())
        self._world.repeat()
        response.message = f"running as far as t = {until / NANOSECONDS:.3f} s"
        return response

    def _push(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        impulse = self._pushing.settings.push_impulse
        plant = self.simulator.plant
        response.success = isinstance(plant, RigidBodyPlant)
        if isinstance(plant, RigidBodyPlant):
            plant.push(impulse)
        response.message = f"pushed with {list(impulse)} N s at t = {self.simulator.time:.3f} s"
        return response

    def _report_clock(self) -> tuple[bytes, str, Mapping[str, Any]]:
        rivals = self._watch.rivals(clocked=not self._settings.is_on_system_clock)
        self._watch.update(self._watch.incompatible() + rivals)
        keeper, wanted = self._time, self._settings.real_time_factor
        achieved = keeper.achieved(self.simulator.now, time.monotonic())
        values = {
            "time": self.simulator.time,
            "real time factor": achieved,
            "real time factor wanted": wanted,
            "wall time lost": keeper.lost,
            "paused": keeper.paused,
            "lockstep": keeper.lockstep,
            "lockstep time-outs": keeper.timeouts,
        }
        if self._watch.complaints:
            return WARN, self._watch.complaints[0].kind, values
        if keeper.paused:
            return OK, "paused", values
        if keeper.awaited is not None and achieved == 0.0:
            return WARN, "waiting for rotor_trajectory", values
        if not keeper.lockstep and achieved < _SLOW * wanted:
            return WARN, f"slower than asked for: {achieved:.3g} of {wanted:g}", values
        return OK, "running", values

    def _report_commands(self) -> tuple[bytes, str, Mapping[str, Any]]:
        counts = dict(self._faults.counts)
        return (WARN, "faults so far", counts) if counts else (OK, "no faults", counts)


_ABOUT = f"""{__doc__}
Parameters are given with --ros-args -p NAME:=VALUE or --params-file FILE.yaml;
msg_docs/parameters.md lists them.
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(SimulatorNode, args, _ABOUT)
