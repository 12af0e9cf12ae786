"""Pursuit: mazes, chasers, evaders and runners, with the exact optimum beside every result.

Importing this package registers the Gymnasium ids `pursuit/Chaser-v0`, `pursuit/Evader-v0` and
`pursuit/Maze-v0`, and the PettingZoo ids `pursuit/chase-v0`, `pursuit/maze-v0` and
`pursuit/race-v0`. Everything else is imported on first use, so that this stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium
import pettingzoo

if TYPE_CHECKING:
    from pursuit.maze import Maze, library_names, load_maze
    from pursuit.maze_generation import generate_maze
    from pursuit.policy import GameView, Policy
    from pursuit.simulator import Simulator
    from pursuit.single_agent import SingleAgentEnv, SingleAgentVectorEnv
    from pursuit.task import Rewards, Task, make_task

__version__ = "0.1.0"
__all__ = [
    "GameView",
    "Maze",
    "Policy",
    "Rewards",
    "Simulator",
    "SingleAgentEnv",
    "SingleAgentVectorEnv",
    "Task",
    "generate_maze",
    "library_names",
    "load_maze",
    "make_task",
]

_HOMES = {
    "GameView": "policy",
    "Maze": "maze",
    "Policy": "policy",
    "Rewards": "task",
    "Simulator": "simulator",
    "SingleAgentEnv": "single_agent",
    "SingleAgentVectorEnv": "single_agent",
    "Task": "task",
    "generate_maze": "maze_generation",
    "library_names": "maze",
    "load_maze": "maze",
    "make_task": "task",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"pursuit.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'pursuit' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


# The default opponents are scripted agents, which build on this package: the entry points are
# strings, so that nothing here imports them.
for _role in ("chaser", "evader", "maze"):
    gymnasium.register(
        id=f"pursuit/{_role.capitalize()}-v0",
        entry_point=f"scripted_agents.environments:{_role}_env",
        vector_entry_point=f"scripted_agents.environments:{_role}_vector_env",
    )
if hasattr(pettingzoo, "register"):  # PettingZoo has a registry since 1.27
    for _task in ("chase", "maze", "race"):
        pettingzoo.register(
            "parallel", f"pursuit/{_task}-v0", entry_point=f"pursuit.{_task}_v0:parallel_env"
        )
