"""Hyperparameters of off-policy algorithms. No torch here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pursuit.validation import check, choice, rule
from train.settings.checks import Count, Finite, NotNegative, Positive, Share
from train.settings.hyperparameters import NetworkSettings

Frames = Annotated[int, rule(lambda value: value >= 0, "must be at least 0")]
Noise = Annotated[str, choice("gaussian", "ornstein-uhlenbeck", "none")]


@dataclass(frozen=True)
class ReplaySettings(NetworkSettings):
    """Hyperparameters of algorithms with a replay buffer."""

    num_games: Count = 512
    """Games simulated in parallel."""
    learning_rate: Positive = 3e-3
    """Initial learning rate of Adam."""
    max_grad_norm: Positive = 10.0
    """Gradients are clipped to this norm."""
    rollout_steps: Count = 8
    """Steps of every game between two updates."""
    gradient_steps: Count = 8
    """Gradient steps of one update."""
    batch_size: Count = 1024
    """Transitions of one gradient step."""
    buffer_size: Count = 200_000
    """Transitions in the replay buffer."""
    learning_starts: Frames = 10_000
    """Frames before the first gradient step."""
    prioritized: bool = False
    """Prioritised experience replay (Schaul et al., 2016)."""
    priority_exponent: Share = 0.6
    """Exponent of the priorities; 0 is uniform sampling."""
    importance_exponent: Share = 0.4
    """Initial exponent of the importance-sampling weights."""
    importance_exponent_end: Share = 1.0
    """Final exponent of the importance-sampling weights, annealed linearly; 1 corrects fully."""
    n_steps: Count = 3
    """Rewards of an n-step return, at most rollout_steps."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.batch_size <= self.buffer_size,
            f"batch_size={self.batch_size} is more than buffer_size={self.buffer_size}; lower it",
        )
        check(
            self.n_steps <= self.rollout_steps,
            f"n_steps={self.n_steps} is more than rollout_steps={self.rollout_steps}, after which "
            "returns are cut off; lower it, or raise rollout_steps",
        )


@dataclass(frozen=True)
class DQNSettings(ReplaySettings):
    """Deep Q-learning (Mnih et al., 2015) with optional extensions."""

    target_update_interval: Count = 50
    """Gradient steps between two updates of the target network."""
    epsilon_start: Share = 1.0
    """Initial probability of a random action."""
    epsilon_end: Share = 0.05
    """Final probability of a random action."""
    exploration_share: Share = 0.3
    """Fraction of the budget over which epsilon is annealed."""
    exploration_frames: Annotated[
        int | None, rule(lambda value: value >= 1, "give at least 1, or leave it out")
    ] = None
    """Frames over which epsilon is annealed, instead of exploration_share."""
    double: bool = True
    """Double Q-learning: the target network evaluates the action that the network chooses (van
    Hasselt et al., 2016)."""
    dueling: bool = False
    """Dueling network: value and advantages instead of action values (Wang et al., 2016)."""


@dataclass(frozen=True)
class NFSPSettings(DQNSettings):
    """Neural fictitious self-play (Heinrich and Silver, 2016)."""

    SELF_PLAY_ONLY: ClassVar[bool] = True
    num_games: Count = 128
    """Games simulated in parallel."""
    batch_size: Count = 256
    """Transitions of one gradient step."""
    learning_starts: Frames = 2000
    """Frames before the first gradient step."""
    target_update_interval: Count = 25
    """Gradient steps between two updates of the target network."""
    anticipatory: Share = 0.1
    """Share of episodes played by the best response instead of the average policy, eta in the
    paper."""
    reservoir_size: Count = 200_000
    """Actions of best responses that the average policy is fitted to, a uniform sample of all."""
    average_learning_rate: Positive = 3e-3
    """Initial learning rate of the average policy's Adam."""
    epsilon_start: Share = 0.06
    """Initial probability of a random action of the best response."""
    epsilon_end: Share = 0.0
    """Final probability of a random action of the best response."""
    exploration_share: Share = 1.0
    """Fraction of the budget over which epsilon is annealed."""
    n_steps: Count = 1
    """Rewards of an n-step return, at most rollout_steps. More than 1 adds a bias, as most actions
    are those of the average policy."""


@dataclass(frozen=True)
class ContinuousSettings(ReplaySettings):
    """Hyperparameters of actor-critic algorithms with a replay buffer and target networks."""

    num_games: Count = 128
    """Games simulated in parallel."""
    learning_rate: Positive = 3e-3
    """Initial learning rate of the actor's Adam."""
    critic_learning_rate: Positive = 3e-3
    """Initial learning rate of the critics' Adam."""
    rollout_steps: Count = 1
    """Steps of every game between two updates."""
    gradient_steps: Count = 1
    """Gradient steps of one update."""
    batch_size: Count = 256
    """Transitions of one gradient step."""
    learning_starts: Frames = 5000
    """Frames of uniformly random actions before the first gradient step."""
    n_steps: Count = 1
    """Rewards of an n-step return, at most rollout_steps."""
    tau: Share = 0.03
    """Step size of the target networks' moving average: 0 keeps the initial weights, 1 copies the
    networks."""
    policy_delay: Count = 1
    """Gradient steps of the critics for each one of the actor."""
    noise: Noise = "gaussian"
    """Exploration noise on the actions: gaussian, ornstein-uhlenbeck (reset with every episode) or
    none."""
    noise_start: NotNegative = 0.3
    """Initial standard deviation of the noise; for ornstein-uhlenbeck that of its increments."""
    noise_end: NotNegative = 0.05
    """Final standard deviation of the noise, annealed linearly."""
    noise_share: Share = 0.5
    """Fraction of the budget over which the noise is annealed."""
    noise_theta: Share = 0.15
    """Mean reversion rate of ornstein-uhlenbeck noise, per step."""


@dataclass(frozen=True)
class DDPGSettings(ContinuousSettings):
    """Deep deterministic policy gradients (Lillicrap et al., 2016)."""


@dataclass(frozen=True)
class TD3Settings(ContinuousSettings):
    """Twin delayed DDPG (Fujimoto et al., 2018)."""

    policy_delay: Count = 2
    """Gradient steps of the critics for each one of the actor."""
    target_noise: NotNegative = 0.2
    """Standard deviation of the noise on the target actor's actions (target policy smoothing)."""
    target_noise_clip: NotNegative = 0.5
    """Clipping range of that noise."""


@dataclass(frozen=True)
class SACSettings(ContinuousSettings):
    """Soft actor-critic (Haarnoja et al., 2018) with an adaptive temperature."""

    noise: Noise = "none"
    """Additional exploration noise on the actions: gaussian, ornstein-uhlenbeck or none."""
    temperature: Positive = 0.02
    """Initial weight of the entropy."""
    adapt_temperature: bool = True
    """Adapt the temperature to keep the entropy near target_entropy."""
    temperature_learning_rate: Positive = 3e-3
    """Initial learning rate of the temperature's Adam."""
    target_entropy: Finite = -3.0
    """Target entropy per action dimension; log 2 is uniform. The usual value -1 leaves an arm too
    uncertain to turn at full speed."""
