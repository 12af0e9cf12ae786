"""Deep Q-learning with a memory: sequences in the replay buffer, begun with what was remembered.

DRQN (Hausknecht and Stone, 2015) as R2D2 has it (Kapturowski et al., 2019): a rollout of a game is
a sequence, stored with the state that the network had then, which is out of date when it is
replayed; so the steps before it are stored as well, and warm the memory up without being learned
from (burn-in). From a start at zero instead, the network would learn to do without what it had seen
before the sequence.
"""

from __future__ import annotations

from typing import Any

import torch

from train.algorithms.collector import NEXT_MASK, Collector, Columns
from train.algorithms.learner import Games
from train.algorithms.replay import Batch, mean
from train.networks.masks import masked
from train.networks.q_network import QNetwork
from train.settings.off_policy import DQNSettings

MAX_SHARE = 0.9
"""A sequence's priority is this share of its largest error, and the rest of their mean."""
WARM = "warm_observation"
WARM_FRESH = "warm_fresh"


def sequence_loss(
    network: QNetwork,
    target: QNetwork,
    batch: Batch,
    settings: DQNSettings,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The squared error of temporal differences along sequences, and a size of each one's errors.

    Returns of `n_steps` rewards end with the sequence, or with the episode where that is sooner.
    A cut-off episode, and the sequence, is bootstrapped by what was seen last and remembered then.

    Args:
        network: learns.
        target: values the next action.
        batch: [sequences]; "observation", "action", "reward", "next_observation", "terminated",
            "truncated" and "fresh" are [sequences, steps, ...], "state" [sequences, numbers] what
            was remembered before "warm_observation" and "warm_fresh" [sequences, burn_in, ...];
            with prioritised replay "priority_weight", with masks "next_action_mask".
        settings: the hyperparameters.

    Returns:
        The loss, and a size of the errors of each sequence [sequences], detached.
    """
    fresh = batch["fresh"]
    own = target_state = batch["state"]
    if settings.burn_in:
        with torch.no_grad():
            own, target_state = (
                one.along(batch[WARM], own, batch[WARM_FRESH])[1][:, -1]
                for one in (network, target)
            )
    values, states = network.along(batch["observation"], own, fresh)
    with torch.no_grad():
        theirs, their_states = target.along(batch["observation"], target_state, fresh)
        apart = batch["truncated"].clone()
        apart[:, -1] = True
        rows = apart.nonzero(as_tuple=True)
        following = batch["next_observation"][rows]
        next_values = _after(theirs, target.remember(following, their_states[rows])[0], rows)
        chooser = next_values
        if settings.double:
            chooser = _after(values.detach(), network.remember(following, states[rows])[0], rows)
        best = masked(chooser, batch.get(NEXT_MASK, None)).argmax(dim=-1, keepdim=True)
        ended = batch["terminated"]
        after = next_values.gather(-1, best).squeeze(-1) * ~ended
        goal = batch["reward"] + settings.gamma * after
        last = ended | apart
        for _ in range(settings.n_steps - 1):
            later = torch.where(last[:, :-1], after[:, :-1], goal[:, 1:])
            later = torch.cat([later, after[:, -1:]], dim=1)
            goal = batch["reward"] + settings.gamma * later
    error = values.gather(-1, batch["action"][..., None]).squeeze(-1) - goal
    squares, size = error.square().mean(dim=1), error.detach().abs()
    size = MAX_SHARE * size.amax(dim=1) + (1.0 - MAX_SHARE) * size.mean(dim=1)
    return mean(squares, batch), size


def _after(values: torch.Tensor, found: torch.Tensor, rows: Any) -> torch.Tensor:
    """[sequences, steps, actions]: the values of the step after each; `found` in `rows`."""
    after = torch.cat([values[:, 1:], values[:, -1:]], dim=1)
    after[rows] = found
    return after


class Recording:
    """Rollouts of a network that remembers as sequences, each with the steps before it.

    Args:
        env: the games.
        collector: plays them.
        settings: the hyperparameters.

    Attributes:
        warm: of every game the last `burn_in` steps, and what was remembered before them.
    """

    def __init__(self, env: Games, collector: Collector, settings: DQNSettings) -> None:
        self.collector, self.burn_in = collector, settings.burn_in
        seen, games = env.observation_spec["observation"], len(collector.state)
        before = (games, settings.burn_in)
        self.warm = {
            WARM: torch.zeros(*before, *seen.shape[1:], dtype=seen.dtype),
            WARM_FRESH: torch.ones(before, dtype=torch.bool),
            "state": torch.zeros(collector.state.shape),
        }

    def sequences(self, rollout: Columns) -> Columns:
        """[games]: a sequence of each, as `sequence_loss` takes them; on the CPU."""
        rollout = {name: column.cpu() for name, column in rollout.items()}
        names = ("observation", "action", "next_observation", "reward", "terminated", NEXT_MASK)
        columns = {**self.warm, **{name: rollout[name] for name in names if name in rollout}}
        columns["fresh"] = rollout["episode_start"]
        columns["truncated"] = rollout["truncated"] & ~rollout["terminated"]
        first, collector = rollout["reward"].shape[1] - self.burn_in, self.collector
        state = collector.states[first] if self.burn_in else collector.state
        self.warm = {
            WARM: columns["observation"][:, first:],
            WARM_FRESH: columns["fresh"][:, first:],
            "state": state.cpu(),
        }
        return columns

    def state_dict(self) -> Columns:
        """What is remembered now, and the last steps."""
        now = {f"now_{name}": tensor for name, tensor in self.collector.state_dict().items()}
        return {**self.warm, **now}

    def load_state_dict(self, state: Columns) -> None:
        """Take it back, before the first rollout."""
        self.warm = {name: state[name] for name in self.warm}
        now = {name: state[f"now_{name}"] for name in self.collector.state_dict()}
        self.collector.load_state_dict(now)
