#!/usr/bin/env python3
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""An environment of Gymnasium, which has to be installed: a sphere that is to rest at a pose."""

from typing import Any

import gymnasium
import numpy as np

from sphere_nmpc import FirstOrderHold, RobotParameters
from sphere_sim import Simulator, SimulatorSettings, draw_scenarios

ROBOT = RobotParameters()
PERIOD, LONGEST = 0.25, 40.0
"""Time of a step, and longest time of an episode [s]."""
SETTLED, AT_REST = 1e-2, 1.0
"""Error [-] and rotor speeds [rad/s] below which the sphere has arrived."""


def observation(pose: Any, speeds: Any, goal: Any) -> Any:
    """Return pose, rotor speeds in units of their limit, and goal, shape (14,)."""
    return np.concatenate((pose, speeds / ROBOT.max_rotor_speed, goal), dtype=np.float32)


class RollToPose(gymnasium.Env[Any, Any]):
    """Random starts and goals; an action is the rotor speeds that a step ends with [limit].

    The reward is that of a run in a suite, with a lower bound of the time for the best known: this
    over the time taken at the arrival, and 0 before.
    """

    observation_space = gymnasium.spaces.Box(-1e3, 1e3, (14,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin at rest at another start, with another goal."""
        super().reset(seed=seed)
        (self._scenario,) = draw_scenarios(1, int(self.np_random.integers(2**31)))
        settings = SimulatorSettings(initial_state=tuple(self._scenario.start))
        self._simulator = Simulator(settings)
        return observation(self._scenario.start, np.zeros(2), self._scenario.goal), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Ramp to the rotor speeds of an action, within the limits of the drives."""
        simulator, goal = self._simulator, self._scenario.goal
        times = simulator.time + np.array([0.0, PERIOD])
        wanted = ROBOT.max_rotor_speed * np.clip(action, -1.0, 1.0)
        ramp = FirstOrderHold(times, np.stack((simulator.speed_reference, wanted)))
        simulator.follower.follow_trajectory(ramp)
        simulator.advance_to(round(1e9 * times[1]))
        pose, speeds = simulator.plant.state, simulator.speed_reference
        signed = np.append(goal[:2], goal[2:] * np.copysign(1.0, pose[2:] @ goal[2:]))
        error = float(np.linalg.norm(pose - signed))
        arrived = error < SETTLED and bool(np.abs(speeds).max() < AT_REST)
        reward = self._scenario.lower_bound(ROBOT) / times[1] if arrived else 0.0
        is_over = bool(times[1] >= LONGEST)
        return observation(pose, speeds, goal), reward, arrived, is_over, {"error": error}


def as_policy(act: Any) -> Any:
    """Return what `sphere_nmpc.score` takes of a function from observation to action."""
    return lambda now: ROBOT.max_rotor_speed * np.asarray(
        act(observation(now.state[:6], now.speeds, now.goal.pose))
    )
