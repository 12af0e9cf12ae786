"""TeamEnv: all seats of one role are the learner's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from pursuit.observations.observations import Encoder
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from train.environments.hooks import EpisodeHook
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import Seat


class TeamEnv(SimulatorEnv):
    """A batch of games in which every agent of a role learns, with shared parameters.

    A learner for one seat learns for all of them (independent PPO; de Witt et al., 2020).

    Args:
        simulator: made with `auto_restart=False`.
        player: its agent is a role.
        policies: whoever fills each seat; None in those of the role.
        hook: changes the next episodes.
        central: observe also what every agent of the role would in full sight, for a central
            critic: [k + 1, *shape], the own observation first. That is the whole state, however
            little the agents themselves see.
        scale: rewards are multiplied by it.
    """

    def __init__(
        self,
        simulator: Simulator,
        player: Seat,
        policies: Sequence[Policy | None],
        hook: EpisodeHook | None = None,
        *,
        central: bool = False,
        scale: float = 1.0,
    ) -> None:
        super().__init__(simulator, player, policies, hook, player.members)
        self.central, self.scale = central, scale
        task = replace(simulator.task, view_radius=None, line_of_sight=False, unknown_maze=False)
        self._all = Encoder(task, player.encoding)
        self._specify_observation()

    def _whole(self) -> torch.Tensor:
        whole = self._all.encode(self.simulator.games, self.seats)
        if self.stack is not None:  # what was before is nothing new to who sees everything now
            flat = whole.reshape(-1, *whole.shape[2:])
            whole = self.stack.seen(self.stack.begun(len(flat), flat.dtype), flat)
            whole = whole.reshape(self.num_games, self.members, *whole.shape[1:])
        return torch.from_numpy(whole)
