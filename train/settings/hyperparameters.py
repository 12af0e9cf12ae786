"""What the settings of all algorithms have in common. No torch here."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

from train.settings.checks import check, check_choice

ACTIVATIONS = ("relu", "tanh")
CELLS = ("gru", "lstm")


def check_activation(name: str) -> None:
    """ValueError for one that the networks have not."""
    check(name in ACTIVATIONS, f"unknown activation {name!r}; one of {', '.join(ACTIVATIONS)}")


@dataclass(frozen=True)
class Hyperparameters:
    """What every algorithm has."""

    COUNTS: ClassVar[frozenset[str]] = frozenset(
        {
            "num_games", "rollout_steps", "minibatch_size", "epochs", "width", "batch_size",
            "buffer_size", "n_steps", "gradient_steps", "target_update_interval", "population",
        }
    )  # fmt: skip
    POSITIVE: ClassVar[frozenset[str]] = frozenset(
        {
            "learning_rate", "max_grad_norm", "clip", "first_std", "adam_epsilon", "initial_std",
            "action_std",
        }
    )  # fmt: skip
    SHARES: ClassVar[frozenset[str]] = frozenset(
        {
            "gamma", "gae_lambda", "epsilon_start", "epsilon_end",
            "exploration_share", "priority_exponent", "importance_exponent",
            "importance_exponent_end", "elite_share",
        }
    )  # fmt: skip

    FINITE: ClassVar[frozenset[str]] = frozenset()
    """Numbers that may be below 0."""

    num_games: int = 1024
    """Games in lockstep."""
    gamma: float = 0.95
    """Discount."""
    recurrent: str | None = None
    """What the network remembers of the episode by: gru or lstm, between its hidden layers and what
    it puts out. None: it knows what it observes now."""

    @property
    def last_gamma(self) -> float:
        """The discount at the end of learning."""
        return self.gamma

    @property
    def central_critic(self) -> bool:
        """Whether a critic is to see what all agents of a role observe."""
        return False

    def __post_init__(self) -> None:
        if self.recurrent is not None:
            check_choice("recurrent", self.recurrent, CELLS)
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if name in self.COUNTS:
                check(1 <= value < 2**63, f"{name}={value}; it is at least 1, and below 2**63")
            elif name in self.POSITIVE:
                check(0 < value < float("inf"), f"{name}={value}; it is above 0")
            elif name in self.SHARES:
                check(0.0 <= value <= 1.0, f"{name}={value}; it lies in [0, 1]")
            elif name in self.FINITE:
                check(abs(value) < float("inf"), f"{name}={value}; it is finite")
            elif isinstance(value, float):
                check(0.0 <= value < float("inf"), f"{name}={value}; it is finite, and at least 0")


@dataclass(frozen=True)
class NetworkSettings(Hyperparameters):
    """The network, and how it descends."""

    learning_rate: float = 1e-2
    """Of Adam, at the start."""
    anneal: bool = True
    """Whether learning rate and entropy bonus are annealed in a straight line to 0."""
    max_grad_norm: float = 0.5
    """Gradients are scaled down to this norm."""
    adam_epsilon: float = 1e-8
    """Adam's epsilon."""
    width: int = 128
    """Units of each of the two hidden layers."""
    activation: str = "relu"
    """relu or tanh."""
    first_std: float = 0.06
    """Standard deviation of the first layer's weights on index at the start."""
    pairs: bool = False
    """On index: weights for every pair of own cell and other cell as well, one table for all goals.
    Fewer frames are needed; each takes longer."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_activation(self.activation)
