"""Separate networks of the agents of a role, behind the interface of a single network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import nn

from train.networks.distributions import Categorical
from train.networks.features import Features
from train.settings.algorithms import SEPARATE, TeamSettings


class Unprepared:
    """In place of a `Trunk`: every network prepares its own observations."""

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """The observation itself."""
        return observation


class SeparateNetworks(nn.Module):
    """The networks of all agents of a role: `ActorCritic` or `QNetwork`, each for its own agent.

    An observation ends with the number of its agent ("+id"), which selects the network.

    Args:
        networks: of the agents, in their order.
        features: of the observation.

    Attributes:
        networks: the argument.
        sizes, form, policy_memory: as of `ActorCritic`.
    """

    def __init__(self, networks: Sequence[Any], features: Features) -> None:
        super().__init__()
        self.networks = nn.ModuleList(networks)
        self.kind, self.first_id = features.kind, len(features.rows) - len(networks)
        self.dims = len(features.shape)
        first = networks[0]
        self.sizes, self.form = getattr(first, "sizes", (0, 0)), getattr(first, "form", None)
        # Not modules of this one: their weights are those of the first network.
        self.__dict__["policy_memory"] = getattr(first, "policy_memory", None)
        self.policy_trunk = self.value_trunk = Unprepared()
        self.policy_head = self.value_head = nn.Identity()

    def owner(self, observation: torch.Tensor) -> torch.Tensor:
        """[...] int64: the number of the agent that each observation [..., *shape] is of."""
        if self.kind == "index":
            return observation[..., -1].long() - self.first_id
        ids = observation.movedim(-self.dims, -1)[..., -len(self.networks) :]
        while ids.dim() > observation.dim() - self.dims + 1:  # any place of its planes
            ids = ids[..., 0, :]
        return ids.argmax(dim=-1)

    def _each(self, method: str, observation: torch.Tensor, *rest: torch.Tensor | None) -> Any:
        """The results of a method of the networks, for each observation [rows, *shape] that of its
        agent; a tuple where the method returns one."""
        owner, whole = self.owner(observation), list[torch.Tensor]()
        for number, network in enumerate(self.networks):
            rows = (owner == number).nonzero().squeeze(-1)
            given = (None if column is None else column[rows] for column in rest)
            found = getattr(network, method)(observation[rows], *given)
            parts = found if isinstance(found, tuple) else (found,)
            if not whole:
                whole = [part.new_zeros(len(owner), *part.shape[1:]) for part in parts]
            pairs = zip(whole, parts, strict=True)
            whole = [results.index_copy(0, rows, part) for results, part in pairs]
        return tuple(whole) if isinstance(found, tuple) else whole[0]

    def forward(self, observation: torch.Tensor, critic: torch.Tensor | None = None) -> Any:
        """As of the networks."""
        rest = () if critic is None else (critic,)
        return self._each("forward", observation, *rest)

    def forward_inference(self, observation: torch.Tensor) -> Any:
        """As of `QNetwork`."""
        return self._each("forward_inference", observation)

    def logits(self, observation: torch.Tensor) -> Any:
        """[rows, actions], as of the networks."""
        return self._each("logits", observation)

    def step(
        self, observation: torch.Tensor, state: torch.Tensor, critic: torch.Tensor | None = None
    ) -> Any:
        """As of `ActorCritic`."""
        return self._each("step", observation, state, critic)

    def remember(self, observation: torch.Tensor, state: torch.Tensor) -> Any:
        """As of `ActorCritic`."""
        return self._each("remember", observation, state)

    def distribution(
        self, output: torch.Tensor, allowed: torch.Tensor | None = None
    ) -> Categorical:
        """The action distribution; as of `ActorCritic`."""
        return Categorical(output, allowed)

    def forward_sequence(
        self, frames: Mapping[str, torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor, Mapping[str, torch.Tensor]]:
        """As of `ActorCritic`, with outputs in place of hidden units; ordered by agent."""
        owner = self.owner(frames["prepared"])
        owner = owner if owner.dim() == 1 else owner[:, 0]  # sequences are of one agent each
        found: list[tuple[torch.Tensor, torch.Tensor, Mapping[str, torch.Tensor]]] = []
        for number, network in enumerate(self.networks):
            rows = (owner == number).nonzero().squeeze(-1)
            if not len(rows):
                continue
            own: Any = network
            part = {name: column[rows] for name, column in frames.items()}
            part["prepared"] = own.policy_trunk.prepare(part["prepared"])
            if "critic_prepared" in part:
                part["critic_prepared"] = own.value_trunk.prepare(part["critic_prepared"])
            hidden, value_hidden, columns = own.forward_sequence(part)
            found.append((own.policy_head(hidden), own.value_head(value_hidden), columns))
        names = [name for name in found[0][2] if name not in ("prepared", "critic_prepared")]
        outputs, values = (torch.cat([each[i] for each in found]) for i in (0, 1))  # type: ignore[misc]
        columns = {name: torch.cat([each[2][name] for each in found]) for name in names}
        return outputs, values, columns

    @property
    def update_form(self) -> str:
        """As of `QNetwork`: of the first network."""
        return str(getattr(self.networks[0], "update_form", "torch"))


def network_of_team(
    network_of: Callable[..., Any], settings: TeamSettings, seat: Any, *rest: Any
) -> Any:
    """A new network for a seat; with `sharing` "separate" one for each agent of its role.

    Args:
        network_of: (settings, seat, *rest) -> a network.
        settings: of the algorithm.
        seat: whose observation ends with "+id", if networks are separate.
        rest: further arguments of `network_of`.
    """
    if settings.sharing == SEPARATE and seat.members > 1:
        networks = [network_of(settings, seat, *rest) for _ in range(seat.members)]
        return SeparateNetworks(networks, seat.features)
    return network_of(settings, seat, *rest)
