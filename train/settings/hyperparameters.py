"""What the settings of all algorithms have in common. No torch here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from train.settings.checks import Count, Positive, Settings, Share, one_of

Activation = Annotated[str, one_of("relu", "tanh")]


@dataclass(frozen=True)
class Hyperparameters(Settings):
    """What every algorithm has."""

    num_games: Count = 1024
    """Games in lockstep."""
    gamma: Share = 0.95
    """Discount."""
    recurrent: Annotated[str | None, one_of("gru")] = None
    """What the network remembers of the episode by: gru, between its hidden layers and what it puts
    out. None: it knows what it observes now."""

    @property
    def last_gamma(self) -> float:
        """The discount at the end of learning."""
        return self.gamma


@dataclass(frozen=True)
class NetworkSettings(Hyperparameters):
    """The network, and how it descends."""

    learning_rate: Positive = 1e-2
    """Of Adam, at the start."""
    anneal: bool = True
    """Whether learning rate and entropy bonus are annealed in a straight line to 0."""
    max_grad_norm: Positive = 0.5
    """Gradients are scaled down to this norm."""
    adam_epsilon: Positive = 1e-8
    """Adam's epsilon."""
    width: Count = 128
    """Units of each of the two hidden layers."""
    activation: Activation = "relu"
    """relu or tanh."""
    first_std: Positive = 0.06
    """Standard deviation of the first layer's weights on index at the start."""
