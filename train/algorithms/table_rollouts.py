"""Rollouts of self-play in small games by tables: the policy is evaluated once in all states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.collector import Collector, Columns
from train.environments.batch_env import BatchEnv
from train.networks.actor_critic import ActorCritic

Evaluate = Callable[[torch.Tensor, torch.Tensor | None], tuple[Any, torch.Tensor]]
"""(observations, masks) -> the distribution of the actions, and the values."""

MOST_STATES = 2
"""States up to which tables are worth their evaluation, in frames of a rollout."""


class TableCollector(Collector):
    """Collects as `Collector`, with the same columns, in games of two whose opponents have tables.

    A step of a batch takes some microseconds instead of a millisecond. Where opponents have no
    tables, rollouts are those of `Collector`.

    Args:
        evaluate: see `Evaluate`.
        keep: the name of the column of the parameters of distributions, or None.
        env, act, steps, device, value: as of `Collector`.
    """

    env: BatchEnv

    def __init__(self, evaluate: Evaluate, keep: str | None, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.evaluate, self.keep = evaluate, keep

    @torch.no_grad()
    def rollout(self) -> Columns:
        """The next rollout, columns [games, steps, ...]; see `Collector.rollout`."""
        if self._now is None:
            self._now = self.env.reset()
        env, seat = self.env, self.env.player
        opponents = env.hook.opponent_tables()
        if opponents is None or env.expert is not None:
            return super().rollout()
        legal = torch.from_numpy(seat.legal) if seat.has_masks else None
        observed = torch.from_numpy(seat.observed)
        distribution, values = self.evaluate(observed, legal)
        sums = distribution.parameters.double().exp().cumsum(dim=1).numpy()
        draws = torch.rand(2, self.steps, env.num_games, dtype=torch.float64).numpy()
        seats = seat.number, 1 - seat.number
        played = env.simulator.play(seats, draws, sums, opponents)
        over = played.terminated | played.truncated
        self._note(played, over)
        now = [torch.from_numpy(array.T.copy()) for array in played[:6]]
        state, action, reward, terminated, truncated, final = now
        state, final = state.long(), final.long()
        if env.bounded:
            terminated, truncated = terminated | truncated, torch.zeros_like(truncated)
        logs = distribution.parameters[state]
        done = terminated | truncated
        start = torch.cat([self.episode_start[:, None], done[:, :-1]], dim=1)
        columns = {
            "observation": observed[state],
            "episode_start": start,
            "action": action,
            "action_log_prob": logs.gather(-1, action[..., None]).squeeze(-1),
            "value": torch.zeros_like(reward) if self.value is None else values[state],
            "reward": reward * env.scale,
            "terminated": terminated,
            "truncated": truncated,
            "done": done,
        }
        if legal is not None:
            columns[ACTION_MASK] = legal[state]
        if self.keep is not None:
            columns[self.keep] = logs
        if self.value is not None:
            cut = truncated.clone()
            cut[:, -1] = ~terminated[:, -1]
            columns["value_after"] = torch.where(cut, values[final], 0.0)
        self.episode_start = done[:, -1]
        self._now = env._observe()
        return columns

    def _note(self, played: Any, over: np.ndarray[Any, np.dtype[np.bool_]]) -> None:
        """Record the episodes that ended."""
        if over.any():
            env, returns = self.env, played.returns[over]
            env.finished_returns.append(returns[:, env.seat])
            env.finished_lengths.append(played.lengths[over])
            env.hook.note_episodes(played.members[over], returns)


def plays_by_tables(env: Any, network: ActorCritic, steps: int, device: str) -> bool:
    """Whether rollouts are collected by tables where opponents have some: in small games of two, by
    networks without memory on the CPU, if the states are few for the frames of a rollout."""
    if device != "cpu" or network.policy_memory is not None or env.player.observed is None:
        return False
    most = MOST_STATES * steps * env.num_games
    return env.simulator.task.num_agents == 2 and len(env.player.observed) <= most
