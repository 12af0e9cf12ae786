"""The settings of the learners that replay what they remember. No torch here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from train.settings.checks import Count, Finite, NotNegative, Positive, Share, check, one_of, rule
from train.settings.hyperparameters import NetworkSettings

Frames = Annotated[int, rule(lambda value: value >= 0, "it is at least 0")]
Noise = Annotated[str, one_of("gaussian", "ornstein-uhlenbeck", "none")]


@dataclass(frozen=True)
class ReplaySettings(NetworkSettings):
    """Collecting into a replay buffer, and gradient steps from it."""

    num_games: Count = 512
    """Games in lockstep."""
    learning_rate: Positive = 3e-3
    """Of Adam, at the start."""
    max_grad_norm: Positive = 10.0
    """Gradients are scaled down to this norm."""
    rollout_steps: Count = 8
    """Steps of every game between two rounds of gradient steps."""
    gradient_steps: Count = 8
    """Gradient steps in a round."""
    batch_size: Count = 1024
    """Transitions of one gradient step."""
    buffer_size: Count = 200_000
    """Transitions that the replay buffer holds."""
    learning_starts: Frames = 10_000
    """Frames before the first gradient step."""
    prioritized: bool = False
    """Replay by the size of the error (Schaul et al., 2016)."""
    priority_exponent: Share = 0.6
    """How much priorities count; 0 is uniform."""
    importance_exponent: Share = 0.4
    """How much the weights undo that at the start."""
    importance_exponent_end: Share = 1.0
    """How much they undo it at the end, reached in a straight line; 1 is all of it."""
    n_steps: Count = 3
    """Rewards before bootstrapping, at most rollout_steps; 1 is the original."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.batch_size <= self.buffer_size,
            f"batch_size={self.batch_size} is more than buffer_size={self.buffer_size}; lower it",
        )
        check(
            self.n_steps <= self.rollout_steps,
            f"n_steps={self.n_steps} is more than rollout_steps={self.rollout_steps}, which cuts "
            "returns off; lower it, or raise rollout_steps",
        )


@dataclass(frozen=True)
class DQNSettings(ReplaySettings):
    """Deep Q-learning (Mnih et al., 2015) and its extensions, each to be switched on and off."""

    target_update_interval: Count = 50
    """Gradient steps between two copies to the target network."""
    epsilon_start: Share = 1.0
    """Share of random actions at the start."""
    epsilon_end: Share = 0.05
    """Share of random actions at the end."""
    exploration_share: Share = 0.3
    """Share of the budget over which epsilon is annealed."""
    exploration_frames: Annotated[
        int | None, rule(lambda value: value >= 1, "at least 1, or leave it out")
    ] = None
    """Frames over which epsilon is annealed instead, whatever the budget is."""
    double: bool = True
    """The network chooses the next action, the target network values it (van Hasselt et al.,
    2016)."""
    dueling: bool = False
    """A value and advantages instead of action values (Wang et al., 2016)."""


@dataclass(frozen=True)
class ContinuousSettings(ReplaySettings):
    """An actor and critics of its actions, with targets that follow them slowly."""

    num_games: Count = 128
    """Games in lockstep."""
    learning_rate: Positive = 3e-3
    """Of the actor's Adam, at the start."""
    critic_learning_rate: Positive = 3e-3
    """Of the critics' Adam, at the start."""
    rollout_steps: Count = 1
    """Steps of every game between two rounds of gradient steps."""
    gradient_steps: Count = 1
    """Gradient steps in a round."""
    batch_size: Count = 256
    """Transitions of one gradient step."""
    learning_starts: Frames = 5000
    """Frames of uniformly random actions before the first gradient step."""
    n_steps: Count = 1
    """Rewards before bootstrapping, at most rollout_steps; 1 is the original."""
    tau: Share = 0.03
    """The share of the way that the targets go towards the networks after a gradient step of the
    actor: 0 leaves them as they were at the start, 1 makes them copies."""
    policy_delay: Count = 1
    """Gradient steps of the critics for one of the actor and of the targets."""
    noise: Noise = "gaussian"
    """What is added to the actor's actions to explore: gaussian, ornstein-uhlenbeck (which drifts,
    and begins anew with every episode) or none."""
    noise_start: NotNegative = 0.3
    """Standard deviation of the noise at the start; with ornstein-uhlenbeck that of its steps."""
    noise_end: NotNegative = 0.05
    """The same at the end, reached in a straight line."""
    noise_share: Share = 0.5
    """Share of the budget over which the noise is annealed."""
    noise_theta: Share = 0.15
    """Share of its way back to 0 that ornstein-uhlenbeck noise goes in a step."""


@dataclass(frozen=True)
class DDPGSettings(ContinuousSettings):
    """Deep deterministic policy gradients (Lillicrap et al., 2016)."""


@dataclass(frozen=True)
class TD3Settings(ContinuousSettings):
    """Twin delayed DDPG (Fujimoto et al., 2018)."""

    policy_delay: Count = 2
    """Gradient steps of the critics for one of the actor and of the targets."""
    target_noise: NotNegative = 0.2
    """Standard deviation of the noise on the target actor's actions."""
    target_noise_clip: NotNegative = 0.5
    """That noise is clipped to this."""


@dataclass(frozen=True)
class SACSettings(ContinuousSettings):
    """Soft actor-critic (Haarnoja et al., 2018) with a temperature that adapts."""

    noise: Noise = "none"
    """What is added to the actor's draws to explore: gaussian, ornstein-uhlenbeck or none."""
    temperature: Positive = 0.02
    """Weight of the policy's entropy, at the start."""
    adapt_temperature: bool = True
    """Adapt the weight to keep the entropy near its target."""
    temperature_learning_rate: Positive = 3e-3
    """Of the temperature's Adam, at the start."""
    target_entropy: Finite = -3.0
    """The entropy sought for each number of an action; that of a uniform one is log 2. Haarnoja et
    al. take -1, which leaves an arm too uncertain to turn at full speed."""
