"""Actor-critic networks: policy and value function with one shared trunk, or one each."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import nn

from train.networks.distributions import Categorical, SquashedNormal
from train.networks.features import Features
from train.networks.layers import Hidden, Trunk, head
from train.networks.recurrent import RecurrentCell, flattened, recurrent_cell_of


class ActorCritic(nn.Module):
    """A policy and a value function, with one shared trunk or one each.

    Args:
        features: of the observation.
        num_actions: number of actions; with `action_std` the dimensions of an action.
        hidden: the hidden layers.
        shared: whether policy and value share the trunk.
        action_std: for continuous actions, the initial standard deviation of every dimension,
            before tanh; None for discrete actions.
        critic: of the observation of a central critic, which has a trunk of its own; None where the
            value is one of the policy's observation.

    Attributes:
        policy_trunk, value_trunk: the trunks; the same object where they are shared.
        policy_head: [width] -> [actions] logits, or [numbers] means before tanh.
        value_head: [width] -> [1].
        log_std: [numbers], logarithms of the state-independent standard deviations; None for
            discrete actions.
        form: the class of the action distribution.
        policy_memory, value_memory: recurrent cells between trunks and heads; the same object where
            the trunks are shared, and None without recurrence.
    """

    log_std: nn.Parameter | None
    policy_memory: RecurrentCell | None
    value_memory: RecurrentCell | None
    form: type[Categorical] | type[SquashedNormal]

    def __init__(
        self,
        features: Features,
        num_actions: int,
        hidden: Hidden,
        shared: bool = True,
        action_std: float | None = None,
        critic: Features | None = None,
    ) -> None:
        super().__init__()
        shared = shared and critic is None
        self.policy_trunk = Trunk(features, hidden)
        self.value_trunk = self.policy_trunk if shared else Trunk(critic or features, hidden)
        self.policy_memory = recurrent_cell_of(hidden)
        self.value_memory = self.policy_memory if shared else recurrent_cell_of(hidden)
        self.policy_head = head(hidden.width, num_actions, 0.01)
        self.value_head = head(hidden.width, 1, 1.0)
        self.log_std, self.form = None, Categorical
        if action_std is not None:
            self.log_std = nn.Parameter(torch.full((num_actions,), math.log(action_std)))
            self.form = SquashedNormal

    @property
    def shared(self) -> bool:
        """Whether policy and value share their trunk."""
        return self.policy_trunk is self.value_trunk

    def forward(
        self, observation: torch.Tensor, critic: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits [..., actions], or means [..., numbers], and value [..., 1].

        Args:
            observation: [..., *shape].
            critic: the observation of the central critic, where there is one.
        """
        hidden, value_hidden = self.hidden(*self._prepared(observation, critic))
        return self.policy_head(hidden), self.value_head(value_hidden)

    def _prepared(
        self, observation: torch.Tensor, critic: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        prepared = self.policy_trunk.prepare(observation)
        return prepared, None if critic is None else self.value_trunk.prepare(critic)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions], or means [..., numbers] before tanh; without the value."""
        trunk = self.policy_trunk
        return self.policy_head(trunk(trunk.prepare(observation)))

    def distribution(
        self, output: torch.Tensor, allowed: torch.Tensor | None = None
    ) -> Categorical | SquashedNormal:
        """The action distribution.

        Args:
            output: of the policy head.
            allowed: [..., actions] bool, the action mask; None allows all.
        """
        if self.log_std is None:
            return Categorical(output, allowed)
        return SquashedNormal(output, self.log_std)

    def act(self, observation: torch.Tensor, noise: torch.Tensor | None = None) -> torch.Tensor:
        """[..., numbers] in [-1, 1]: continuous actions.

        Args:
            observation: [..., *shape].
            noise: [..., numbers], standard normal draws; None for the greedy action.
        """
        assert self.log_std is not None, "actions are discrete; use `logits`"
        mean = self.logits(observation)
        return (mean if noise is None else mean + self.log_std.exp() * noise).tanh()

    def hidden(
        self, prepared: torch.Tensor, critic: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The outputs of the trunks for the two heads, [..., width] each, before recurrent cells.

        Args:
            prepared: by `policy_trunk`, which serves both trunks without a central critic.
            critic: the observation of the central critic, prepared by `value_trunk`.
        """
        hidden = self.policy_trunk(prepared)
        if self.shared:
            return hidden, hidden
        return hidden, self.value_trunk(prepared if critic is None else critic)

    # -- recurrence ------------------------------------------------------------------------------

    @property
    def sizes(self) -> tuple[int, int]:
        """Sizes of the recurrent states of policy and value; the latter is 0 where shared."""
        own = self.policy_memory.size if self.policy_memory else 0
        other = self.value_memory.size if self.value_memory and not self.shared else 0
        return own, other

    def remember(
        self, observation: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """`logits` of a step [games, actions], and the policy's next state.

        Args:
            observation: [games, *shape].
            state: [games, numbers], the policy's state only.
        """
        assert self.policy_memory is not None
        trunk = self.policy_trunk
        hidden, state = self.policy_memory.step(trunk(trunk.prepare(observation)), state)
        return self.policy_head(hidden), state

    def step(
        self, observation: torch.Tensor, state: torch.Tensor, critic: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """As `forward`, and the next state [games, sum of `sizes`], which has 0 columns without
        recurrence.

        Args:
            observation: [games, *shape].
            state: [games, sum of `sizes`], the state before the step.
            critic: as of `forward`.
        """
        if self.policy_memory is None:
            return *self(observation, critic), state
        hidden, value_hidden = self.hidden(*self._prepared(observation, critic))
        own, other = torch.split(state, list(self.sizes), dim=-1)
        hidden, own = self.policy_memory.step(hidden, own)
        if self.shared:
            value_hidden = hidden
        elif self.value_memory is not None:
            value_hidden, other = self.value_memory.step(value_hidden, other)
        state = torch.cat([own, other], dim=-1)
        return self.policy_head(hidden), self.value_head(value_hidden), state

    def forward_sequence(
        self, frames: Mapping[str, torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor, Mapping[str, torch.Tensor]]:
        """The inputs of the two heads, [frames, width] each, and the other columns of the frames.

        Args:
            frames: columns [frames, ...] with "observation", or "prepared" by `Trunk.prepare`; with
                a central critic "critic_prepared", by `value_trunk`. For a recurrent network,
                columns [games, steps, ...] of sequences: "episode_start" marks the first steps of
                episodes, "state" [games, sum of `sizes`] is the state before the first step, and
                the optional "loss_mask" selects the frames of the loss.
        """
        prepared = frames.get("prepared", None)
        if prepared is None:
            prepared = self.policy_trunk.prepare(frames["observation"])
        hidden, value_hidden = self.hidden(prepared, frames.get("critic_prepared", None))
        if self.policy_memory is None:
            return hidden, value_hidden, frames
        own, other = torch.split(frames["state"], list(self.sizes), dim=-1)
        hidden = self.policy_memory(hidden, own, frames["episode_start"])[0]
        if self.shared:
            value_hidden = hidden
        elif self.value_memory is not None:
            value_hidden = self.value_memory(value_hidden, other, frames["episode_start"])[0]
        columns = {**frames, "hidden": hidden, "value_hidden": value_hidden}
        flat = flattened(columns)
        return flat.pop("hidden"), flat.pop("value_hidden"), flat
