"""Hyperparameters of every algorithm: frozen dataclasses. No torch here."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar, Self

from pursuit.observations.custom import check_observation
from pursuit.plugins import Registry
from pursuit.validation import check, choice
from train.settings.checks import Count, NotNegative, Positive, Settings, Share
from train.settings.hyperparameters import Activation, Momentum
from train.settings.hyperparameters import Hyperparameters as Hyperparameters
from train.settings.hyperparameters import NetworkSettings as NetworkSettings
from train.settings.off_policy import DDPGSettings as DDPGSettings
from train.settings.off_policy import DQNSettings as DQNSettings
from train.settings.off_policy import NFSPSettings as NFSPSettings
from train.settings.off_policy import SACSettings as SACSettings
from train.settings.off_policy import TD3Settings as TD3Settings

SHARED, SEPARATE, JOINT = "shared", "separate", "joint"
"""Networks of the agents of a role: one of all, one of each, or one of the team as one player."""
NO_NETWORK = ("network", "frame_stack", "device", "precision", "fused")
"""Settings of a run for networks of this package."""
STATE = "state"
"""The observation of a central critic that has the cells of all agents, goals and exits."""


@dataclass(frozen=True)
class ActorCriticSettings(NetworkSettings):
    """Hyperparameters of algorithms with a policy and a value function."""

    entropy_coef: NotNegative = 0.01
    """Initial weight of the entropy bonus."""
    entropy_end: NotNegative = 0.0
    """Weight of the entropy bonus at the end of training; see `anneal`."""
    value_coef: NotNegative = 0.5
    """Weight of the value loss."""
    shared: bool = True
    """Share the hidden layers between policy and value function."""
    action_std: Positive = 1.0
    """Initial standard deviation of continuous actions, before tanh; it is learned."""
    standardize_advantages: bool = True
    """Scale advantages to mean 0 and standard deviation 1: in each minibatch (ppo), in each rollout
    (a2c), in each batch of episodes (reinforce)."""
    gamma_end: float | None = None
    """Discount at the end of training, below 1. None: `gamma` throughout."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gamma_end is not None:
            check(
                max(self.gamma, self.gamma_end) < 1.0 and self.gamma_end >= 0.0,
                f"gamma={self.gamma}, gamma_end={self.gamma_end}; both must be in [0, 1) to anneal "
                "the discount: lower them, or leave gamma_end out",
            )

    def per_step(self, steps: int) -> Self:
        """As in `Hyperparameters`."""
        own, end = super().per_step(steps), self.gamma_end
        return own if end is None else replace(own, gamma_end=end ** (1.0 / steps))

    @property
    def last_gamma(self) -> float:
        """As in `Hyperparameters`."""
        return self.gamma if self.gamma_end is None else self.gamma_end

    def gamma_at(self, progress: float) -> float:
        """The discount at a time in [0, 1]: the horizon 1 / (1 - discount) grows geometrically from
        that of `gamma` to that of `gamma_end`."""
        if self.gamma_end is None:
            return self.gamma
        return 1.0 - (1.0 - self.gamma) ** (1.0 - progress) * (1.0 - self.gamma_end) ** progress


@dataclass(frozen=True)
class RolloutSettings(ActorCriticSettings):
    """Hyperparameters of algorithms that learn from rollouts of fixed length."""

    rollout_steps: Count = 16
    """Steps of every game in a rollout."""
    gae_lambda: Share = 0.9
    """Lambda of generalised advantage estimation."""


def check_minibatch(hyper: Hyperparameters, standardized: bool) -> None:
    """ValueError unless a minibatch is a part of a rollout, from which advantages can be scaled."""
    frames, size = hyper.num_games * hyper.rollout_steps, hyper.minibatch_size
    check(
        size <= frames,
        f"minibatch_size={size} is more than a rollout of num_games × rollout_steps = {frames} "
        "frames; lower it",
    )
    check(
        size > 1 or not standardized,
        f"minibatch_size={size} is too small: advantages are standardised in each minibatch, which "
        "needs at least 2 frames; raise it",
    )


@dataclass(frozen=True)
class PPOSettings(RolloutSettings):
    """Proximal policy optimisation (Schulman et al., 2017).

    `tuned.toml` has the defaults that depend on the task.
    """

    minibatch_size: Count = 4096
    """Frames of one gradient step."""
    epochs: Count = 2
    """Passes over each rollout."""
    clip: Positive = 0.2
    """Clipping range of the probability ratio."""
    kl_target: NotNegative = 0.0
    """Target of the KL divergence from the policy that collected the rollout. Above 0, a KL penalty
    with an adaptive weight is added to the clipped objective."""
    kl_coef: NotNegative = 0.2
    """Initial weight of the KL penalty."""
    critic: bool = True
    """Learn a value function. Without it, returns end with the rollout and have no baseline."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_minibatch(self, self.standardize_advantages)

    def as_ppo(self) -> PPOSettings:
        """These."""
        return self


@dataclass(frozen=True)
class LibraryPPOSettings(Hyperparameters):
    """PPO of another library: the settings that all have, with the usual defaults of libraries for
    losses and network, and ours for sizes. The learning rate is annealed to 0."""

    UNUSED: ClassVar[tuple[str, ...]] = NO_NETWORK
    anneal = True  # by the libraries themselves

    rollout_steps: Count = 16
    """Steps of every game in a rollout."""
    minibatch_size: Count = 4096
    """Frames of one gradient step."""
    epochs: Count = 2
    """Passes over each rollout."""
    learning_rate: Positive = 1e-2
    """Initial learning rate of Adam."""
    gae_lambda: Share = 0.9
    """Lambda of generalised advantage estimation."""
    clip: Positive = 0.2
    """Clipping range of the probability ratio."""
    entropy_coef: NotNegative = 0.01
    """Weight of the entropy bonus."""
    value_coef: NotNegative = 0.5
    """Weight of the value loss."""
    max_grad_norm: Positive = 0.5
    """Gradients are clipped to this norm."""
    width: Count = 128
    """Units of each of the two hidden layers."""
    activation: Activation = "tanh"
    """Activation function: relu or tanh."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_minibatch(self, standardized=True)


def ppo_settings(settings: ActorCriticSettings, **own: float) -> PPOSettings:
    """The settings of a PPO with the same rollouts, network and optimiser, changed by `own`."""
    names = {field.name for field in fields(PPOSettings)}
    shared = {name: value for name, value in vars(settings).items() if name in names} | own
    return PPOSettings(**shared, minibatch_size=shared["num_games"] * shared["rollout_steps"])


@dataclass(frozen=True)
class TeamSettings(Settings):
    """Hyperparameters of algorithms that train all agents of a role."""

    sharing: Annotated[str, choice(SHARED, SEPARATE, JOINT)] = SHARED
    """shared: the agents of the role share one network; separate: each has its own; joint: the team
    is one player, whose network chooses the joint action."""
    agent_id: bool = True
    """Whether the agents of a team observe their number within the role (encoding +id). Separate
    networks always do."""
    critic_observation = ""
    """Observation of the central critic or mixing network; without annotation it is no field."""

    @property
    def with_id(self) -> bool:
        """Whether observations end with the number of the agent."""
        return self.sharing == SEPARATE or (self.agent_id and self.sharing == SHARED)


def check_critic(name: str) -> None:
    """ValueError unless a central critic or mixing network can have this observation."""
    if name == STATE:
        return
    try:
        check_observation(name)
    except ValueError as refused:
        raise ValueError(f"critic_observation: {refused}; or {STATE}") from None


@dataclass(frozen=True)
class IPPOSettings(TeamSettings, PPOSettings):
    """Independent PPO of all agents of a role (de Witt et al., 2020): every agent has a value of
    its own observation."""


@dataclass(frozen=True)
class MAPPOSettings(TeamSettings, PPOSettings):
    """PPO of all agents of a role with a central critic (Yu et al., 2022): values are of the state,
    which policies need not observe."""

    critic_observation: str = STATE
    """Observation of the critic: state (the cells of all agents, goals and exits, with the number
    of the agent), or an observation such as planes, seen with full view."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_critic(self.critic_observation)
        check(self.critic, "critic=False with a central critic; use algorithm ippo")


@dataclass(frozen=True)
class IQLSettings(TeamSettings, DQNSettings):
    """Independent Q-learning of all agents of a role (Tan, 1993; Tampuu et al., 2017): every agent
    has action values of its own observation, from its own reward."""


@dataclass(frozen=True)
class VDNSettings(TeamSettings, DQNSettings):
    """Value decomposition networks (Sunehag et al., 2018): deep Q-learning of the sum of the action
    values of all agents of a role, from their mean reward."""


@dataclass(frozen=True)
class QMIXSettings(VDNSettings):
    """QMIX (Rashid et al., 2018): as VDN, with a network that mixes the action values of the agents
    monotonically, by weights that depend on the state."""

    critic_observation: str = STATE
    """Observation of the mixing network: state (the cells of all agents, goals and exits), or an
    observation such as planes of the first agent, seen with full view."""
    mixing_width: Count = 32
    """Hidden units of the mixing network."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_critic(self.critic_observation)


@dataclass(frozen=True)
class A2CSettings(RolloutSettings):
    """Advantage actor-critic (Mnih et al., 2016, synchronous)."""

    num_games: Count = 512
    """Games simulated in parallel."""
    rollout_steps: Count = 4
    """Steps of every game in a rollout."""
    learning_rate: Positive = 6e-3
    """Initial learning rate of Adam."""
    gae: bool = True
    """Use generalised advantage estimation. Without it, advantages are discounted returns minus the
    value."""
    critic: bool = True
    """Learn a value function. Without it, returns end with the rollout and have no baseline."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.num_games * self.rollout_steps > 1 or not self.standardize_advantages,
            "standardize_advantages=True needs rollouts of at least 2 frames; raise num_games or "
            "rollout_steps",
        )

    def as_ppo(self) -> PPOSettings:
        """The same rollouts and loss in the terms of PPO."""
        return ppo_settings(self) if self.gae else ppo_settings(self, gae_lambda=1.0)


@dataclass(frozen=True)
class ReinforceSettings(ActorCriticSettings):
    """REINFORCE (Williams, 1992), which learns from whole episodes."""

    ADDED: ClassVar[tuple[str, ...]] = ("standardize_advantages",)
    num_games: Count = 128
    """Episodes between two updates."""
    learning_rate: Positive = 2e-2
    """Initial learning rate of Adam."""
    baseline: bool = True
    """Subtract a learned value function from the returns."""

    def as_ppo(self) -> PPOSettings:
        """As of A2C; there are no rollouts of a fixed length, so that their steps are unused."""
        return ppo_settings(self, critic=self.baseline, rollout_steps=2)


@dataclass(frozen=True)
class ReferenceSettings(PPOSettings):
    """PPO for self-play that is regularised towards a slower reference policy."""

    SELF_PLAY_ONLY: ClassVar[bool] = True
    num_games: Count = 512
    """Games simulated in parallel."""
    learning_rate: Positive = 3e-3
    """Initial learning rate of Adam."""
    minibatch_size: Count = 2048
    """Frames of one gradient step."""
    adam_beta1: Momentum = 0.0
    """Momentum of Adam: it amplifies cycles around equilibria (Gidel et al., 2019)."""
    gae_lambda: Share = 0.5
    """Lambda of generalised advantage estimation."""
    entropy_coef: NotNegative = 0.0
    """Initial weight of the entropy bonus."""
    reference_interval: Count = 1
    """Iterations between two updates of the reference policy."""
    reference_rate: Share = 1.0
    """Step size of an update of the reference policy's weights: 1 copies those of the policy."""


@dataclass(frozen=True)
class MMDSettings(ReferenceSettings):
    """Magnetic mirror descent (Sokota et al., 2023). The reference policy is the magnet."""

    magnet_coef: NotNegative = 0.2
    """Weight of KL(policy, magnet), alpha in the paper."""
    step_coef: NotNegative = 0.1
    """Weight of KL(policy, collecting policy), 1 / eta in the paper."""
    reference_rate: Share = 0.05
    """Step size of an update of the magnet's weights: 1 copies those of the policy."""


@dataclass(frozen=True)
class RNaDSettings(ReferenceSettings):
    """Regularised Nash dynamics (Perolat et al., 2022)."""

    reward_coef: NotNegative = 0.05
    """Weight of the log-ratio of policy and reference policy in the rewards, eta in the paper. It
    is in units of the rewards, which zero_sum scales by 1 - gamma."""
    reference_interval: Count = 20
    """Iterations between two updates of the reference policy."""


@dataclass(frozen=True)
class CrossEntropySettings(Hyperparameters):
    """The cross-entropy method on network weights (Rubinstein, 1999; Szita and Lőrincz, 2006)."""

    num_games: Count = 1024
    """Games simulated in parallel, divided among the population."""
    population: Count = 64
    """Number of weight vectors in each generation."""
    elite_share: Share = 0.125
    """Fraction of the population that the next distribution is fitted to."""
    initial_std: Positive = 0.2
    """Initial standard deviation of every weight."""
    extra_std: NotNegative = 0.01
    """Added to the standard deviations against premature convergence, and annealed to 0."""
    action_std: Positive = 0.1
    """Standard deviation of continuous actions, before tanh; it is constant."""
    width: Count = 32
    """Units of each of the two hidden layers."""
    activation: Activation = "tanh"
    """Activation function: relu or tanh."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.num_games % self.population == 0,
            f"num_games={self.num_games} is not a multiple of population={self.population}; give a "
            "multiple of it",
        )
        check(
            round(self.population * self.elite_share) >= 2,
            f"elite_share={self.elite_share} of population={self.population} is less than two; "
            "raise one of them",
        )


@dataclass(frozen=True)
class QLearningSettings(Hyperparameters):
    """Tabular Q-learning (Watkins, 1989)."""

    UNUSED: ClassVar[tuple[str, ...]] = NO_NETWORK

    num_games: Count = 1024
    """Games simulated in parallel."""
    gamma: Share = 1.0
    """Discount factor."""
    learning_rate: Positive = 1.0
    """Step size at the first visit of a state-action pair. 1 is correct in deterministic tasks."""
    learning_rate_power: NotNegative = 0.0
    """The step size is divided by the number of visits to this power. Use more than 0.5 in
    stochastic tasks."""
    optimism: NotNegative = 1.0
    """Initial action value per remaining goal (once in tasks without goals). A value that is at
    least the best possible return makes exploration optimistic."""
    epsilon_start: Share = 0.05
    """Initial probability of a random action."""
    epsilon_end: Share = 0.05
    """Final probability of a random action."""
    exploration_share: Share = 0.5
    """Fraction of the budget over which epsilon is annealed."""


@dataclass(frozen=True)
class TrackedSettings(Hyperparameters):
    """Of learners outside of this package (`train.Tracker`)."""

    num_games: Count = 1
    """No games are simulated for learning."""
    gamma: Share = 1.0
    """Discount of the objective gap in results."""


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
    "mmd": MMDSettings,
    "rnad": RNaDSettings,
    "nfsp": NFSPSettings,
    "ippo": IPPOSettings,
    "mappo": MAPPOSettings,
    "iql": IQLSettings,
    "vdn": VDNSettings,
    "qmix": QMIXSettings,
    "sb3_ppo": LibraryPPOSettings,
    "cleanrl_ppo": LibraryPPOSettings,
    "tracked": TrackedSettings,
}
"""The hyperparameters of every algorithm by name; see `algorithms/registry.py` for the learners."""


TUNED_AS = {"ippo": "ppo", "mappo": "ppo", "iql": "dqn", "vdn": "dqn", "qmix": "dqn"}
"""The algorithms whose tuned hyperparameters others have."""


def is_algorithm(part: object) -> bool:
    """Whether a part is an `Algorithm`."""
    form = getattr(part, "settings", None)
    return isinstance(form, type) and issubclass(form, Hyperparameters)


LEARNERS: Registry[Any] = Registry(
    "algorithm", "a train.algorithms.registry.Algorithm", is_algorithm, ours=tuple(HYPERPARAMETERS)
)
"""User-defined algorithms."""


def hyperparameter_form(algorithm: str) -> type[Hyperparameters]:
    """The hyperparameter class of an algorithm; ValueError for an unknown name."""
    if isinstance(algorithm, str) and algorithm in HYPERPARAMETERS:
        return HYPERPARAMETERS[algorithm]
    return LEARNERS.get(algorithm).settings
