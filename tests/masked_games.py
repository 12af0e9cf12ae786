"""Games with masks, and what counts the steps that led nowhere."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.rules import STAY
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents.environments import default_policies
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import MazeSeat


def torchrl_env(role: str, games: int = 16, mask_bumps: bool = True, **settings: Any) -> Any:
    """The learner in one seat, or with several agents of its role in all of theirs."""
    task = make_task("chase", **{"maze": "3x3", "max_steps": 12, **settings})
    simulator = Simulator(task, games, auto_restart=False)
    seat = MazeSeat(task, role, mask_bumps=mask_bumps)
    policies = default_policies(task, 0.2)
    others = [None if other == role else policies[other] for other in task.seat_roles]
    return SimulatorEnv(simulator, seat, others, members=seat.members)


def count_bumps(simulator: Simulator, seat: int) -> dict[str, int]:
    """Counts from now on the steps of active agents in a seat, and those that led nowhere."""
    counted, step, stay = {"steps": 0, "bumps": 0}, simulator.step, simulator.task.stay_action

    def counting(actions: Any) -> None:
        before, plays = simulator.positions.copy(), simulator.active[:, seat] & ~simulator.ended
        chosen = np.array(actions)[:, seat]
        step(actions)
        still = (simulator.positions == before)[:, seat] & ~(stay & (chosen == STAY))
        counted["steps"] += int(plays.sum())
        counted["bumps"] += int((still & (plays != 0)).sum())

    simulator.step = counting  # type: ignore[method-assign]
    return counted
