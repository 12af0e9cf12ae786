"""Names of the types that environments share."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import gymnasium
from pettingzoo import AECEnv, ParallelEnv

from pursuit.rules.arrays import Array

Space = gymnasium.Space[Any]
Observations: TypeAlias = Array | dict[str, Array]
"""Of one game or of a batch; with masks in the observation a dict."""
Actions: TypeAlias = Mapping[str, Any]
"""The action of every agent by its name."""
Info = dict[str, Any]
"""The infos of an agent, of a game, or of a batch of games."""
Options = dict[str, Any] | None
"""The options of a reset."""
Single: TypeAlias = gymnasium.Env[Any, Any]
Vector: TypeAlias = gymnasium.vector.VectorEnv[Any, Any, Any]
Parallel: TypeAlias = ParallelEnv[str, Any, Any]
TurnBased: TypeAlias = AECEnv[str, Any, Any]
