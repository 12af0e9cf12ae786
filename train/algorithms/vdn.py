"""Value decomposition networks and QMIX: deep Q-learning of a team with a common reward."""

from __future__ import annotations

import torch

from train.algorithms.collector import NEXT_CRITIC, Columns
from train.algorithms.dqn import DQN
from train.algorithms.replay import NEXT_IDLE
from train.networks.policy import CRITIC


class VDN(DQN):
    """Sunehag et al. (2018): the value of a joint action is the sum of the values of all agents; in
    QMIX (Rashid et al., 2018) the network mixes them (`Mixer`).

    A row of the replay buffer is a step of a whole game; the reward is the mean of the agents'.
    Agents that have left the game add nothing. With one agent it is `DQN`.
    """

    def store(self, rollout: Columns) -> None:
        """Regroup the frames of a rollout [games * agents, steps] by game, and store them."""
        members = self.env.player.members
        if members == 1:
            super().store(rollout)
            return

        def by_game(column: torch.Tensor) -> torch.Tensor:
            """[games, steps, agents, ...]"""
            games = len(column) // members
            return column.view(games, members, *column.shape[1:]).movedim(1, 2)

        columns = {name: by_game(column) for name, column in rollout.items()}
        states = [name for name in (CRITIC, NEXT_CRITIC) if name in columns]
        terminated = columns["terminated"]
        super().store(
            columns
            | {
                "idle": columns["idle"].squeeze(-1),
                NEXT_IDLE: terminated,
                "reward": columns["reward"].mean(dim=2),
                "terminated": terminated.all(dim=2),
                "done": columns["done"].all(dim=2),
                **{name: columns[name][:, :, 0] for name in states},
            }
        )
        self.frames += (members - 1) * terminated[:, :, 0].numel()
