# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop over a simulated link that delays and loses messages, in simulated time."""

import heapq
import itertools
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.control.clock_watch import ClockWatch
from sphere_nmpc.control.clocked_schedule import ClockedSchedule
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.schedule import Actions, PlanRequest, TimedPose
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

STEP = 0.002
"""Spacing of the instants at which something happens [s]."""
_REPEAT = 0.5
"""Time after which a goal that is not in force is sent again [s]."""
_HOLD = 1.0
"""How long the sphere has to stay at a goal [s]."""


@dataclass(frozen=True)
class LinkSettings:
    """Properties of the link and of what runs on its ends.

    Attributes
    ----------
    delay, jitter : float
        Delay of a message, drawn from delay - jitter to delay + jitter [s].
    loss : float
        Share of messages that are lost in either direction.
    bursts : tuple of float
        Times at which everything is lost for `burst` seconds [s].
    burst : float
        Length of a burst [s].
    heartbeat : float
        Time after which a lost command is sent again, before which no later one is delivered, as
        by a reliable subscription [s]; 0 is best effort.
    simulated : bool
        Whether the controller's clock is a topic and so delayed, too; otherwise the clocks of
        both ends agree.
    joint_states : bool
        Whether the controller hears the rotor speeds.
    pose_rate : float
        Rate of pose, joint states and clock [Hz].
    copies : int
        How often a command is sent while commands may be late or lost.
    spacing : float
        Time between two copies [s].
    planning : float
        Duration of a plan [s].
    """

    delay: float = 0.02
    jitter: float = 0.01
    loss: float = 0.0
    bursts: tuple[float, ...] = ()
    burst: float = 2.0
    heartbeat: float = 0.0
    simulated: bool = True
    joint_states: bool = True
    pose_rate: float = 50.0
    copies: int = 3
    spacing: float = 0.02
    planning: float = 0.01


class _Channel:
    """One topic over the link; without retransmission what was overtaken is dropped."""

    def __init__(self, link: LinkSettings, seed: int, heartbeat: float = 0.0) -> None:
        self._link = link
        self._random = np.random.default_rng(seed)
        self._heartbeat = heartbeat
        self._numbers = itertools.count()
        self._pending: list[tuple[float, int, object]] = []
        self._newest = -1
        self._blocked_until = 0.0

    def send(self, now: float, message: object) -> None:
        link, number = self._link, next(self._numbers)
        due = now + link.delay + link.jitter * self._random.uniform(-1.0, 1.0)
        lost = self._random.random() < link.loss
        lost |= any(start <= now < start + link.burst for start in link.bursts)
        if lost and not self._heartbeat:
            return
        if lost:
            self._blocked_until = due + self._heartbeat * self._random.uniform(0.0, 1.0)
        if self._heartbeat:
            due = max(due, self._blocked_until)
        heapq.heappush(self._pending, (due, number, message))

    def receive(self, now: float) -> list[object]:
        received = []
        while self._pending and self._pending[0][0] <= now:
            _, number, message = heapq.heappop(self._pending)
            if number > self._newest:
                self._newest = number
                received.append(message)
        return received


class LinkedLoop:
    """Simulator and controller with a link in between, as their nodes call them."""

    def __init__(
        self, link: LinkSettings, settings: ControllerSettings | None = None, seed: int = 0,
        robot: RobotParameters | None = None,
    ) -> None:
        settings = ControllerSettings() if settings is None else settings
        self.link = link
        start = SimulatorSettings(pose_rate=link.pose_rate, seed=seed)
        nominal = RobotParameters()
        self.simulator = Simulator(start, nominal if robot is None else robot)
        self.controller = Controller(settings, nominal)
        self._watch = ClockWatch(link.simulated)
        self.schedule = ClockedSchedule(settings, self._watch)
        seeds = itertools.count(10 * seed)
        self._poses, self._joints, self._clock, self._goals = (
            _Channel(link, next(seeds)) for _ in range(4)
        )
        self._commands = _Channel(link, next(seeds), link.heartbeat)
        self._instants = itertools.count(1)
        self._now: float | None = None
        self._accepted: Vector | None = None
        self._next_tick = 0.0
        self._busy_until = 0.0
        self._copies: list[tuple[float, FirstOrderHold]] = []
        self._outbox: list[tuple[float, FirstOrderHold]] = []

    def go(self, goal: Vector, limit: float = 60.0) -> float | None:
        """Return the time to a goal, shape (6,), from sending it [s]; None if not reached."""
        time = sent = resent = self.simulator.time
        inside = None
        self._goals.send(sent, goal)
        while time < sent + limit:
            self.step()
            time = self.simulator.time
            if time >= resent + _REPEAT and self._accepted is not goal:
                resent = time
                self._goals.send(time, goal)
            if state_error(self.simulator.plant.state, goal) >= SETTLED_ERROR:
                inside = None
            elif inside is None:
                inside = time
            elif time - inside >= _HOLD:
                return inside - sent
        return None

    def step(self) -> None:
        """Advance by one instant."""
        simulator, link = self.simulator, self.link
        simulator.advance_to(round(next(self._instants) * STEP * NANOSECONDS))
        true = simulator.time
        if simulator.now % round(NANOSECONDS / link.pose_rate) == 0:
            for stamp, pose in simulator.poses():
                self._poses.send(true, TimedPose(stamp, stamp / NANOSECONDS, pose))
            self._joints.send(true, (true, simulator.plant.rotor_speeds.copy()))
            self._clock.send(true, true)
        for hold in self._commands.receive(true):
            simulator.follower.follow_trajectory(hold)
        self._run_controller(true)

    def _run_controller(self, true: float) -> None:
        while self._outbox and self._outbox[0][0] <= true:
            self._send(true, self._outbox.pop(0)[1])
        while self._copies and self._copies[0][0] <= true:
            self._commands.send(true, self._copies.pop(0)[1])
        if true < self._busy_until:
            return
        controller, schedule = self.controller, self.schedule
        for time in self._clock.receive(true):
            self._now = time
        if not self.link.simulated:
            self._now = true
        if self._now is not None:
            self._watch.read(self._now, true)
        if self.link.joint_states:
            for time, speeds in self._joints.receive(true):
                controller.observe_rotors(time, speeds)
                schedule.window = controller.rotor_feedback.window
        for pose in self._poses.receive(true)[-1:]:
            actions = schedule.pose_received(pose, self._now)
            self._carry_out(actions, true)
            if actions.observe is not None:
                self._start(true)
        for goal in self._goals.receive(true):
            self._accepted = goal
            if controller.set_goal(goal):
                schedule.goal_changed()
                self._start(true)
        if self._now is not None and self._now >= self._next_tick and true >= self._busy_until:
            period = schedule.timer_period
            self._next_tick += period * max(1, np.floor((self._now - self._next_tick) / period))
            self._carry_out(schedule.tick(self._now), true)

    def _start(self, true: float) -> None:
        if self._now is None or true < self._busy_until:
            return
        actions = self.schedule.start(self._now, self.controller.awaits_start)
        if actions is not None:
            self._next_tick = self._now + self.schedule.timer_period
            self._carry_out(actions, true)

    def _carry_out(self, actions: Actions, true: float) -> None:
        if actions.observe is not None:
            self.controller.observe(actions.observe.time, actions.observe.state)
        if actions.plan is not None:
            self._plan(actions.plan, true)

    def _plan(self, request: PlanRequest, true: float) -> None:
        elapsed = self.link.planning
        decision = self.controller.decide(request.instant)
        starts = self.schedule.command_time(request, elapsed)
        hold = self.schedule.command(request, self.controller.commit(decision, starts))
        if hold is not None:
            self._busy_until = true + elapsed
            self._outbox.append((self._busy_until, hold))
        self.schedule.completed(elapsed, decision.solved)

    def _send(self, true: float, hold: FirstOrderHold) -> None:
        self._commands.send(true, hold)
        self._copies = []
        if self.controller.rotor_feedback.shows_link:
            spacing = self.link.spacing
            self._copies = [(true + i * spacing, hold) for i in range(1, self.link.copies)]


def random_goals(number: int, seed: int, reach: float = 1.5) -> list[Vector]:
    """Return goals, shape (6,) each, within `reach` [m] of the origin."""
    random = np.random.default_rng(seed)
    goals = []
    for _ in range(number):
        quaternion = random.normal(size=4)
        place = random.uniform(-reach, reach, size=2)
        goals.append(np.concatenate((place, quaternion / np.linalg.norm(quaternion))))
    return goals
