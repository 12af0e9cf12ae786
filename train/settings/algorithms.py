"""The settings of every algorithm: frozen dataclasses, checked at birth. No torch here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pursuit.plugins import Registry
from train.settings.checks import Count, NotNegative, Positive, Share, check
from train.settings.hyperparameters import Activation, Hyperparameters, NetworkSettings
from train.settings.off_policy import DDPGSettings, DQNSettings, SACSettings, TD3Settings

__all__ = [
    "HYPERPARAMETERS",
    "LEARNERS",
    "A2CSettings",
    "ActorCriticSettings",
    "CrossEntropySettings",
    "DDPGSettings",
    "DQNSettings",
    "Hyperparameters",
    "NetworkSettings",
    "PPOSettings",
    "QLearningSettings",
    "ReinforceSettings",
    "RolloutSettings",
    "SACSettings",
    "TD3Settings",
    "hyperparameter_form",
    "is_algorithm",
]


@dataclass(frozen=True)
class ActorCriticSettings(NetworkSettings):
    """Policy and value."""

    entropy_coef: NotNegative = 0.01
    """Weight of the entropy bonus at the start."""
    value_coef: NotNegative = 0.5
    """Weight of the value loss."""
    shared: bool = True
    """Whether policy and value share their hidden layers."""
    action_std: Positive = 1.0
    """Standard deviation of continuous actions, before tanh, at the start; it is learned."""
    gamma_end: float | None = None
    """The discount at the end, below 1; None for `gamma` throughout."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gamma_end is not None:
            check(
                max(self.gamma, self.gamma_end) < 1.0 and self.gamma_end >= 0.0,
                f"gamma={self.gamma}, gamma_end={self.gamma_end}; between two discounts from 0 on "
                "and below 1 there is a way by how far they look ahead: lower them, or leave "
                "gamma_end out",
            )

    @property
    def last_gamma(self) -> float:
        """As in `Hyperparameters`."""
        return self.gamma if self.gamma_end is None else self.gamma_end

    def gamma_at(self, progress: float) -> float:
        """The discount at a time in [0, 1]: the steps that it looks ahead, 1 / (1 - discount), grow
        by the same factor in equal times."""
        if self.gamma_end is None:
            return self.gamma
        return 1.0 - (1.0 - self.gamma) ** (1.0 - progress) * (1.0 - self.gamma_end) ** progress


@dataclass(frozen=True)
class RolloutSettings(ActorCriticSettings):
    """Learning from rollouts of fixed length."""

    rollout_steps: Count = 16
    """Steps of every game between two updates."""
    gae_lambda: Share = 0.9
    """Lambda of generalised advantage estimation."""


@dataclass(frozen=True)
class PPOSettings(RolloutSettings):
    """Proximal policy optimisation (Schulman et al., 2017)."""

    minibatch_size: Count = 4096
    """Frames of one gradient step."""
    epochs: Count = 2
    """Passes over each rollout."""
    clip: Positive = 0.2
    """Clipping of the probability ratio."""
    kl_target: NotNegative = 0.0
    """Above 0 a penalty on the divergence from the policy that collected is added to the clipped
    objective, and its weight adapted to keep the divergence near this target."""
    kl_coef: NotNegative = 0.2
    """Weight of that penalty at the start."""
    critic: bool = True
    """Learn a value; without, returns end with the rollout and nothing is subtracted from them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        frames = self.num_games * self.rollout_steps
        check(
            self.minibatch_size <= frames,
            f"minibatch_size={self.minibatch_size} is more than a rollout of num_games × "
            f"rollout_steps = {frames} frames; lower it",
        )
        check(
            self.minibatch_size > 1,
            f"minibatch_size={self.minibatch_size}: advantages are standardised in each minibatch, "
            "which takes at least 2 frames; raise it",
        )


@dataclass(frozen=True)
class A2CSettings(RolloutSettings):
    """Advantage actor-critic (Mnih et al., 2016, synchronous)."""

    num_games: Count = 512
    """Games in lockstep."""
    rollout_steps: Count = 4
    """Steps of every game between two updates."""
    learning_rate: Positive = 6e-3
    """Of Adam, at the start."""
    gae: bool = True
    """Generalised advantages; without, discounted returns less the value."""
    critic: bool = True
    """Learn a value; without, returns end with the rollout and nothing is subtracted from them."""
    standardize_advantages: bool = True
    """Scale the advantages of each rollout to mean 0 and standard deviation 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.num_games * self.rollout_steps > 1 or not self.standardize_advantages,
            "standardize_advantages=True with a rollout of 1 frame, which has no standard "
            "deviation; raise num_games or rollout_steps",
        )


@dataclass(frozen=True)
class ReinforceSettings(ActorCriticSettings):
    """REINFORCE (Williams, 1992) on whole episodes."""

    num_games: Count = 64
    """Episodes between two updates."""
    learning_rate: Positive = 1e-2
    """Of Adam, at the start."""
    baseline: bool = True
    """Subtract a learned value from the returns."""


@dataclass(frozen=True)
class CrossEntropySettings(Hyperparameters):
    """The cross-entropy method on network weights (Rubinstein, 1999; Szita and Lőrincz, 2006)."""

    num_games: Count = 1024
    """Games in lockstep, shared out among the population."""
    population: Count = 64
    """Weight vectors in each generation."""
    elite_share: Share = 0.125
    """Share of the population that the next distribution is fitted to."""
    initial_std: Positive = 0.3
    """Standard deviation of every weight at the start."""
    extra_std: NotNegative = 0.02
    """Added to the standard deviations, annealed to 0: it keeps the search from ending early."""
    action_std: Positive = 0.1
    """Standard deviation of continuous actions, before tanh; it is not searched."""
    width: Count = 16
    """Units of each of the two hidden layers."""
    activation: Activation = "tanh"
    """relu or tanh."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.num_games % self.population == 0,
            f"num_games={self.num_games} cannot be shared out among population={self.population}; "
            "give a multiple of it",
        )
        check(
            round(self.population * self.elite_share) >= 2,
            f"elite_share={self.elite_share} of population={self.population} is fewer than two; "
            "raise one of them",
        )


@dataclass(frozen=True)
class QLearningSettings(Hyperparameters):
    """Tabular Q-learning (Watkins, 1989)."""

    num_games: Count = 1024
    """Games in lockstep."""
    gamma: Share = 1.0
    """Discount."""
    learning_rate: Positive = 1.0
    """Step size at the first visit of a state and action; 1 is right where nothing is random."""
    learning_rate_power: NotNegative = 0.0
    """The step size is divided by the number of visits to this power; above 0.5 for tasks with
    random opponents."""
    optimism: NotNegative = 1.0
    """Every action's value at the start, for each goal that is left (without goals, once). At least
    the best that can be had, it makes the greedy action the one that is known least."""
    epsilon_start: Share = 0.05
    """Share of random actions at the start."""
    epsilon_end: Share = 0.05
    """Share of random actions at the end."""
    exploration_share: Share = 0.5
    """Share of the budget over which epsilon is annealed."""


HYPERPARAMETERS: dict[str, type[Hyperparameters]] = {
    "ppo": PPOSettings,
    "a2c": A2CSettings,
    "reinforce": ReinforceSettings,
    "dqn": DQNSettings,
    "ddpg": DDPGSettings,
    "td3": TD3Settings,
    "sac": SACSettings,
    "cross_entropy": CrossEntropySettings,
    "q_learning": QLearningSettings,
}
"""The settings of every algorithm by its name; `algorithms/registry.py` says what each can do."""


def is_algorithm(part: Any) -> bool:
    """Whether a part is an `Algorithm`."""
    form = getattr(part, "settings", None)
    return isinstance(form, type) and issubclass(form, Hyperparameters)


LEARNERS: Registry[Any] = Registry(
    "algorithm",
    "a train.algorithms.registry.Algorithm",
    is_algorithm,
    ours=tuple(HYPERPARAMETERS),
)
"""Algorithms of users' own."""


def hyperparameter_form(algorithm: str) -> type[Hyperparameters]:
    """The settings of an algorithm by its name; ValueError for an unknown one."""
    if algorithm in HYPERPARAMETERS:
        return HYPERPARAMETERS[algorithm]
    form: type[Hyperparameters] = LEARNERS.get(algorithm).settings
    return form
