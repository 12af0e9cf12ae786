"""Names of the types of environments that have no narrower type."""

from typing import Any, TypeAlias

import gymnasium
from pettingzoo import AECEnv, ParallelEnv

Space = gymnasium.Space[Any]
Info = dict[str, Any]
"""The infos of an agent, of a game, or of a batch of games."""
Options = dict[str, Any] | None
"""The options of a reset."""
Parallel: TypeAlias = ParallelEnv[str, Any, Any]
TurnBased: TypeAlias = AECEnv[str, Any, Any]
