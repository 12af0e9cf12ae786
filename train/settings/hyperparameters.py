"""Hyperparameters common to all algorithms. No torch here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

from pursuit.validation import choice, rule
from train.settings.checks import Count, Positive, Settings, Share

Activation = Annotated[str, choice("relu", "tanh")]
Momentum = Annotated[float, rule(lambda value: 0 <= value < 1, "must be in [0, 1)")]


@dataclass(frozen=True)
class Hyperparameters(Settings):
    """Hyperparameters of every algorithm."""

    num_games: Count = 1024
    """Games simulated in parallel."""
    gamma: Share = 0.95
    """Discount factor."""
    recurrent: Annotated[str | None, choice("gru")] = None
    """Recurrent layer between the hidden layers and the output: gru, or None."""
    GROUP: ClassVar[str] = "Learner"
    """The group in help texts."""
    SELF_PLAY_ONLY: ClassVar[bool] = False
    """Whether the algorithm is for self-play only."""
    UNUSED: ClassVar[tuple[str, ...]] = ()
    """Settings of a run that the algorithm does not use."""

    # Values of learners that lack these settings; without annotations they are no fields.
    anneal = False
    """Whether the learning rate ends at 0."""
    rollout_steps = 1
    """Steps of every game between two updates."""
    minibatch_size = 0
    """Frames of one gradient step on a rollout."""
    buffer_size = 0
    """Transitions in the replay buffer."""
    reservoir_size = 0
    """Actions that an average policy is fitted to."""
    width = 0
    """Units of each hidden layer."""

    def per_step(self, steps: int) -> Self:
        """The same with the discount of each of so many steps of a round; `gamma` is of a round."""
        return replace(self, gamma=self.gamma ** (1.0 / steps))

    @property
    def last_gamma(self) -> float:
        """The discount at the end of training."""
        return self.gamma


@dataclass(frozen=True)
class NetworkSettings(Hyperparameters):
    """Hyperparameters of the network and its optimiser."""

    learning_rate: Positive = 1e-2
    """Initial learning rate of Adam."""
    anneal: bool = True
    """Anneal the learning rate linearly to 0, and the entropy bonus to `entropy_end`."""
    max_grad_norm: Positive = 0.5
    """Gradients are clipped to this norm."""
    adam_epsilon: Positive = 1e-8
    """Epsilon of Adam."""
    adam_beta1: Momentum = 0.9
    """Momentum of Adam: the decay of its mean of gradients."""
    width: Count = 128
    """Units of each of the two hidden layers."""
    activation: Activation = "relu"
    """Activation function: relu or tanh."""
    first_std: Positive = 0.06
    """Initial standard deviation of the weights of the first layer, for observation index."""
