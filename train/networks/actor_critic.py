"""Networks: from an observation to the logits of a policy and to a value.

Two hidden layers. On the "index" encoding the first layer has two forms that are the same function:
an embedding bag that sums the rows named by the observation, and a matrix product with the one-hot
vector that those rows stand for. Neither is always faster; `first_layer_form` decides.
"""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import nn

from pursuit.observations import Encoder

FirstLayerForm = Literal["bag", "dense"]


def first_layer_form(num_rows: int) -> FirstLayerForm:
    """The faster form of the first layer, as `tests/benchmarks/bench_learning.py` measures it.

    The matrix product grows with the rows of the weight matrix, the bag does not; on two cores
    without bfloat16 in hardware they met at about 300 rows, at widths of 128 and 256 alike.
    """
    return "bag" if num_rows > 300 else "dense"


class IndexLayer(nn.Module):
    """A linear layer on the "index" encoding; goals share one block of rows.

    Which goal is which means nothing, so the goals' rows are summed with the same weights: the
    layer cannot tell one order of the goals from another.

    Args:
        encoder: of the encoding "index".
        num_agents: entities before the goals.
        width: outputs.
        form: "bag" or "dense"; the same function of the same parameters.
        std: standard deviation of the weights at first.
    """

    rows: torch.Tensor

    def __init__(
        self,
        encoder: Encoder,
        num_agents: int,
        width: int,
        form: FirstLayerForm,
        std: float = 0.06,
    ) -> None:
        super().__init__()
        cells, entities = encoder.num_cells, encoder.num_entities
        blocks = [min(entity, num_agents) for entity in range(entities)]
        blocks.append(num_agents + (entities > num_agents))
        rows = torch.cat([torch.arange(cells) + block * cells for block in blocks])
        self.num_rows = (blocks[-1] + 1) * cells
        self.register_buffer("rows", torch.cat([rows, torch.tensor([self.num_rows])]), False)
        self.weight = nn.Parameter(torch.empty(self.num_rows + 1, width))
        self.bias = nn.Parameter(torch.zeros(width))
        self.form = form
        nn.init.normal_(self.weight, std=std)
        with torch.no_grad():
            self.weight[self.num_rows] = 0.0

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., entities + 1] rows of `weight` to sum, or [..., num_rows] what they stand for."""
        rows = self.rows[observation.long()]
        if self.form == "bag":
            return rows
        one_hot = torch.zeros(*rows.shape[:-1], self.num_rows + 1, device=rows.device)
        one_hot.scatter_add_(-1, rows, torch.ones((), device=rows.device).expand(rows.shape))
        return one_hot[..., : self.num_rows]

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width]."""
        if self.form == "dense":
            return nn.functional.linear(prepared, self.weight[: self.num_rows].T, self.bias)
        rows = prepared.reshape(-1, prepared.shape[-1])
        summed = nn.functional.embedding_bag(
            rows, self.weight, mode="sum", padding_idx=self.num_rows
        )
        return (summed + self.bias).reshape(*prepared.shape[:-1], -1)


class Flat(nn.Module):
    """Any other encoding as a flat vector, scaled to about [0, 1]."""

    scale: torch.Tensor

    def __init__(self, encoder: Encoder, width: int) -> None:
        super().__init__()
        self.dims = len(encoder.shape)
        high = torch.as_tensor(encoder.space.high, dtype=torch.float32).reshape(-1)
        self.register_buffer("scale", 1.0 / high.clamp(min=1.0), False)
        self.linear = nn.Linear(len(high), width)

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., numbers of the observation] float32."""
        flat = observation.flatten(-self.dims) if self.dims > 1 else observation
        return flat.float() * self.scale

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width]."""
        hidden: torch.Tensor = self.linear(prepared)
        return hidden


class Convolutions(nn.Module):
    """Two 3×3 convolutions over "planes", then a linear layer."""

    def __init__(self, encoder: Encoder, width: int) -> None:
        super().__init__()
        planes, height, columns = encoder.shape
        self.layers = nn.Sequential(
            nn.Conv2d(planes, 32, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3, padding=1),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(32 * height * columns, width),
        )

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """The observation itself."""
        return observation

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width] from [..., planes, height, width]."""
        hidden: torch.Tensor = self.layers(prepared.reshape(-1, *prepared.shape[-3:]))
        return hidden.reshape(*prepared.shape[:-3], -1)


class Trunk(nn.Module):
    """Two hidden layers of `width` units with ReLU or tanh on any encoding.

    With `bfloat16` the matrix products run under autocast; parameters and outputs stay float32.
    """

    def __init__(
        self,
        encoder: Encoder,
        num_agents: int,
        width: int,
        form: FirstLayerForm | None = None,
        bfloat16: bool = False,
        std: float = 0.06,
        activation: str = "relu",
    ) -> None:
        super().__init__()
        first: IndexLayer | Flat | Convolutions
        if encoder.encoding == "index":
            rows = (min(num_agents + 1, encoder.num_entities) + 1) * encoder.num_cells
            form = form or first_layer_form(rows)
            first = IndexLayer(encoder, num_agents, width, form, std)
        elif encoder.encoding == "planes":
            first = Convolutions(encoder, width)
        else:
            first = Flat(encoder, width)
        second = nn.Linear(width, width)
        nn.init.orthogonal_(second.weight, 2.0**0.5)
        nn.init.zeros_(second.bias)
        between = nn.Tanh if activation == "tanh" else nn.ReLU
        self.first, self.rest = first, nn.Sequential(between(), second, between())
        self.autocast_bfloat16 = bfloat16
        self.casts = bfloat16 and isinstance(first, IndexLayer) and first.form == "dense"

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """What the first layer works on: without parameters, so once is enough for many epochs."""
        prepared = self.first.prepare(observation)
        # Zeros and ones are exact in bfloat16, and need no cast in every pass then.
        return prepared.bfloat16() if self.casts else prepared

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width] float32, from what `prepare` made of observations."""
        with torch.autocast(prepared.device.type, torch.bfloat16, enabled=self.autocast_bfloat16):
            hidden: torch.Tensor = self.rest(self.first(prepared))
        return hidden.float()


def head(width: int, outputs: int, gain: float) -> nn.Linear:
    """A linear output layer with orthogonal weights of the given gain and no bias at first."""
    layer = nn.Linear(width, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class ActorCritic(nn.Module):
    """A policy and a value: one shared trunk, or one each.

    Attributes:
        policy_trunk, value_trunk: the trunks; the same object where they are shared.
        policy_head: [width] -> [actions] logits.
        value_head: [width] -> [1].
    """

    def __init__(
        self,
        encoder: Encoder,
        num_agents: int,
        num_actions: int,
        width: int = 128,
        shared: bool = True,
        form: FirstLayerForm | None = None,
        bfloat16: bool = False,
        std: float = 0.06,
        activation: str = "relu",
    ) -> None:
        super().__init__()
        arguments = (encoder, num_agents, width, form, bfloat16, std, activation)
        self.policy_trunk = Trunk(*arguments)
        self.value_trunk = self.policy_trunk if shared else Trunk(*arguments)
        self.policy_head = head(width, num_actions, 0.01)
        self.value_head = head(width, 1, 1.0)

    @property
    def shared(self) -> bool:
        """Whether policy and value share their trunk."""
        return self.policy_trunk is self.value_trunk

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits [..., actions] and value [..., 1]."""
        hidden, value_hidden = self.hidden(self.policy_trunk.prepare(observation))
        return self.policy_head(hidden), self.value_head(value_hidden)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions], without the value."""
        trunk = self.policy_trunk
        logits: torch.Tensor = self.policy_head(trunk(trunk.prepare(observation)))
        return logits

    def hidden(self, prepared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What the two heads work on, [..., width] each; `policy_trunk.prepare` serves both."""
        hidden = self.policy_trunk(prepared)
        return hidden, hidden if self.shared else self.value_trunk(prepared)


class CentralActorCritic(ActorCritic):
    """A policy on what one agent observes, and a value of what its whole team observes (MAPPO).

    Observations are [..., k + 1, *shape]: the agent's own, then those of all k agents of its role.
    The critic is TorchRL's `MultiAgentMLP`, centralised: one network on all k observations at once
    (Yu et al., 2022). `logits` takes the agent's own observation alone, [..., *shape].

    Args:
        encoder: of the encoding "index".
        num_agents: entities before the goals.
        num_actions: 4 or 5.
        members: k, agents of the role.
        width: of all hidden layers.
        bfloat16, std, activation: as in `Trunk`.
    """

    def __init__(
        self,
        encoder: Encoder,
        num_agents: int,
        num_actions: int,
        members: int,
        width: int = 128,
        bfloat16: bool = False,
        std: float = 0.06,
        activation: str = "relu",
    ) -> None:
        from torchrl.modules import MultiAgentMLP

        rest: Any = (False, "dense", bfloat16, std, activation)
        super().__init__(encoder, num_agents, num_actions, width, *rest)
        first: Any = self.policy_trunk.first
        del self.value_trunk
        self.critic = MultiAgentMLP(
            n_agent_inputs=first.num_rows,
            n_agent_outputs=width,
            n_agents=members,
            centralized=True,
            share_params=True,
            depth=1,
            num_cells=width,
            activation_class=nn.Tanh if activation == "tanh" else nn.ReLU,
        )

    @property
    def shared(self) -> bool:
        """False: the critic is a network of its own."""
        return False

    def hidden(self, prepared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """[..., width] each for policy and value, from [..., k + 1, rows]."""
        team: torch.Tensor = self.critic(prepared[..., 1:, :].float())
        # With shared parameters a centralised critic says the same of every agent of the team.
        return self.policy_trunk(prepared[..., 0, :]), team[..., 0, :].relu()


class DuelingHead(nn.Module):
    """A value and the actions' advantages over their mean (Wang et al., 2016, equation 9)."""

    def __init__(self, width: int, num_actions: int) -> None:
        super().__init__()
        self.value, self.advantage = head(width, 1, 1.0), head(width, num_actions, 0.1)

    def forward(self, hidden: torch.Tensor) -> torch.Tensor:
        """[..., actions] from [..., width]."""
        advantage = self.advantage(hidden)
        q_values: torch.Tensor = (
            self.value(hidden) + advantage - advantage.mean(dim=-1, keepdim=True)
        )
        return q_values


class QNetwork(nn.Module):
    """Action values.

    Attributes:
        policy_trunk: the hidden layers.
        policy_head: [..., width] -> [..., actions].
    """

    def __init__(
        self,
        encoder: Encoder,
        num_agents: int,
        num_actions: int,
        width: int = 128,
        dueling: bool = False,
        form: FirstLayerForm | None = None,
        bfloat16: bool = False,
        std: float = 0.06,
        activation: str = "relu",
    ) -> None:
        super().__init__()
        self.policy_trunk = Trunk(encoder, num_agents, width, form, bfloat16, std, activation)
        self.policy_head = (
            DuelingHead(width, num_actions) if dueling else head(width, num_actions, 0.1)
        )

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] float32: the expected discounted return of each action."""
        q_values: torch.Tensor = self.policy_head(
            self.policy_trunk(self.policy_trunk.prepare(observation))
        )
        return q_values

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """The same: the greedy action has the largest."""
        return self(observation)
