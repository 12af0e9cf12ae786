"""Tuned hyperparameters by algorithm and task, and those of the thesis for comparison."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pursuit.validation import check, one_of
from train.settings.algorithms import (
    HYPERPARAMETERS,
    A2CSettings,
    ActorCriticSettings,
    DDPGSettings,
    DQNSettings,
    Hyperparameters,
    NetworkSettings,
    PPOSettings,
    QLearningSettings,
    ReinforceSettings,
    RolloutSettings,
    TD3Settings,
    hyperparameter_form,
)
from train.settings.curricula import CurriculumSettings, ScheduleSettings, curriculum_form

TUNED = "tuned"
SIZES = ("num_games", "rollout_steps", "minibatch_size")
"""The budget does not change the defaults where the user gives one of these."""
ITERATIONS, FEWEST_GAMES = 90, 64
"""Budgets for fewer iterations lower PPO's number of games to a power of two of at least 64."""
CURRICULUM_EPISODES, LONGEST = 3.0, 0.5
"""The preset's curriculum then lasts so many episodes, but at most this share of the budget."""


@dataclass(frozen=True)
class TaskProfile:
    """The properties of a task that tuned settings depend on.

    Attributes:
        task: its name.
        role: of the learning agent: "chaser", "evader", "runner" or "arm".
        cells: of the largest maze.
        random_start: whether starts are random; False: the marks of the maze.
        duel: whether one chaser plays against one evader.
        joints: of an arm.
        recurrent: whether the network is recurrent.
        many_mazes: whether games are played in several mazes, as those of a suite.
        goals: of an episode.
    """

    task: str
    role: str
    cells: int
    random_start: bool = True
    duel: bool = False
    joints: int = 0
    recurrent: bool = False
    many_mazes: bool = False
    goals: int = 0

    @property
    def many_goals(self) -> float:
        """Position of the number of goals between 3 (0) and 8 (1)."""
        return on_the_way(self.goals, 3, 8)

    @property
    def far_evader(self) -> float:
        """Position of a chaser's maze size between 25 cells (0) and 49 (1)."""
        far = self.random_start and self.role == "chaser"
        return on_the_way(self.cells, 25, 49) if far else 0.0

    @property
    def far_goals(self) -> float:
        """Position of a runner's maze size between 25 cells (0) and 81 (1)."""
        far = self.random_start and self.role == "runner"
        return on_the_way(self.cells, 25, 81) if far else 0.0

    @property
    def unseen_mazes(self) -> bool:
        """Whether a runner learns to plan in any maze."""
        return self.many_mazes and self.random_start and self.role == "runner"


def on_the_way(count: int, start: int, end: int) -> float:
    """Logarithmic position of `count` between `start` and `end`, clipped to [0, 1]."""
    return min(max(math.log(count / start) / math.log(end / start), 0.0), 1.0) if count else 0.0


def between(near: float, far: float, share: float) -> float:
    """Geometric interpolation between two positive numbers."""
    return float(f"{near * (far / near) ** share:.3g}")


def towards(near: Any, far: Any, share: float, discount: bool) -> Any:
    """Interpolation between two values of a setting: discounts by their horizons, whole numbers in
    multiples of 256."""
    if share == 1.0:
        return far
    if discount:
        return 1.0 - between(1.0 - near, 1.0 - far, share)
    found = between(near, far, share)
    return round(found / 256) * 256 if isinstance(near, int) else found


# The settings of the thesis. Settings that its tables do not list are RLlib's defaults of 2020.

# Table A.5. RLlib collected 4000 frames with few environments; 20 games × 200 steps are that many.
_PPO = PPOSettings(
    num_games=20,
    rollout_steps=200,
    minibatch_size=128,
    epochs=30,
    learning_rate=5e-5,
    anneal=False,
    gamma=0.99,
    gae_lambda=1.0,
    clip=0.5,
    kl_target=0.01,
    kl_coef=0.2,
    entropy_coef=0.0,
    value_coef=1.0,
    max_grad_norm=1e9,
    width=256,
    activation="tanh",
    shared=False,
)

# Of DDPG and TD3. RLlib had one game. Its Ornstein-Uhlenbeck noise has a sigma of 0.2, which it
# scales by 0.1 and the range of an action, 2.
_CONTINUOUS: dict[str, Any] = {
    "num_games": 1,
    "rollout_steps": 1,
    "gradient_steps": 1,
    "batch_size": 512,
    "learning_rate": 1e-3,
    "critic_learning_rate": 1e-3,
    "anneal": False,
    "gamma": 0.99,
    "tau": 0.001,
    "max_grad_norm": 1e9,
    "noise": "ornstein-uhlenbeck",
    "noise_start": 0.04,
    "noise_end": 0.04,
    "noise_theta": 0.15,
    "n_steps": 1,
    "width": 256,
}

THESIS: dict[str, Hyperparameters] = {
    "thesis-ppo": _PPO,
    # Table A.3, with "use critic: False": no baseline is subtracted from the returns. RLlib's PPO
    # of 2020 first ignored that option with generalised advantages, its default, and later refused
    # the combination. The version that the thesis used is unknown.
    "thesis-reacher-ppo": replace(_PPO, critic=False, kl_target=0.005, clip=0.3, width=512),
    # Table A.6 (no critic, no generalised advantages). RLlib's batch of 200 frames in fragments of
    # 20: 10 games × 20 steps. It did not standardise advantages.
    "thesis-a2c": A2CSettings(
        num_games=10,
        rollout_steps=20,
        learning_rate=1e-4,
        anneal=False,
        gamma=0.99,
        gae=False,
        critic=False,
        standardize_advantages=False,
        entropy_coef=0.01,
        max_grad_norm=40.0,
        width=256,
        activation="tanh",
        shared=False,
    ),
    # Table A.4 (dueling, prioritised, 50 000 transitions). RLlib: one game, a batch of 32 for every
    # 4 frames, epsilon 1 to 0.02 over 10 000 frames, the target network copied every 500 frames,
    # the exponent of the importance weights 0.4 throughout.
    "thesis-dqn": DQNSettings(
        num_games=1,
        rollout_steps=4,
        gradient_steps=1,
        batch_size=32,
        buffer_size=50_000,
        learning_starts=1000,
        target_update_interval=125,
        learning_rate=5e-4,
        anneal=False,
        gamma=0.99,
        max_grad_norm=40.0,
        epsilon_end=0.02,
        exploration_frames=10_000,
        double=True,
        dueling=True,
        prioritized=True,
        importance_exponent_end=0.4,
        n_steps=1,
        width=256,
        activation="tanh",
    ),
    # Table A.1. RLlib: a gradient step for every frame after 1500, the exponent of the importance
    # weights 0.4 throughout.
    "thesis-ddpg": DDPGSettings(
        **_CONTINUOUS,
        buffer_size=5000,
        learning_starts=1500,
        prioritized=True,
        importance_exponent_end=0.4,
    ),
    # Table A.2, and the thesis' Ornstein-Uhlenbeck noise.
    "thesis-td3": TD3Settings(
        **_CONTINUOUS,
        buffer_size=10_000,
        learning_starts=10_000,
        policy_delay=2,
        target_noise=0.2,
        target_noise_clip=0.5,
    ),
}
PRESETS = (TUNED, *THESIS)


def preset_algorithm(preset: str) -> str | None:
    """The algorithm of a preset; None for `tuned`, which applies to all.

    Raises:
        ValueError: an unknown preset.
    """
    one_of("preset", preset, PRESETS)
    return None if preset == TUNED else preset.removeprefix("thesis-").removeprefix("reacher-")


def hyperparameters(
    algorithm: str, setting: TaskProfile, preset: str = TUNED, own_gamma: bool = False
) -> Hyperparameters:
    """The hyperparameters of `algorithm` for a task.

    With `own_gamma` the user sets the discount, so that no annealing of it is configured.

    Raises:
        ValueError: an unknown algorithm or preset, or a preset of another algorithm.
    """
    hyperparameter_form(algorithm)
    owner = preset_algorithm(preset)
    check(
        owner in (None, algorithm),
        f"preset={preset!r} is for algorithm {owner!r}, not {algorithm!r}; leave one of them out",
    )
    hyper = tuned(algorithm, setting) if owner is None else THESIS[preset]
    if own_gamma and isinstance(hyper, ActorCriticSettings):
        return replace(hyper, gamma_end=None)
    return hyper


_BOTH_GRADIENTS = (A2CSettings, ReinforceSettings)
TUNED_SETTINGS: tuple[tuple[Any, Callable[[TaskProfile], float], dict[str, Any]], ...] = (
    # Random opponents need averages over visits. A discount bounds values of rewards per step.
    (QLearningSettings, lambda s: s.task != "maze", {"learning_rate_power": 0.7}),
    (QLearningSettings, lambda s: s.task != "maze" and s.role == "evader", {"gamma": 0.95}),
    (DQNSettings, lambda s: s.role == "runner", {"gamma": 0.98}),
    (DQNSettings, lambda s: s.role == "runner" and s.task != "race", {"gamma": 0.99}),
    (_BOTH_GRADIENTS, lambda s: s.task == "maze", {"gamma_end": 0.99}),
    (
        A2CSettings,
        lambda s: s.task == "maze" or s.role == "chaser",
        {"standardize_advantages": False, "entropy_coef": 0.04},
    ),
    (PPOSettings, lambda s: s.role == "runner", {"gamma": 0.99}),
    (
        PPOSettings,
        lambda s: s.role in ("runner", "chaser"),
        {"entropy_coef": 0.1, "value_coef": 2.0},
    ),
    (PPOSettings, lambda s: s.many_goals * (s.role in ("runner", "chaser")), {"value_coef": 0.5}),
    (
        PPOSettings,
        lambda s: s.many_goals * (s.role == "runner" and s.task == "maze"),
        {"gamma_end": 0.997},
    ),
    (NetworkSettings, lambda s: s.far_evader, {"gamma": 0.98}),
    (
        RolloutSettings,
        lambda s: s.far_evader,
        {"entropy_coef": 0.06, "value_coef": 0.5, "gae_lambda": 0.8},
    ),
    (
        PPOSettings,
        lambda s: s.far_goals,
        {"num_games": 2048, "minibatch_size": 8192, "learning_rate": 8e-3},
    ),
    (_BOTH_GRADIENTS, lambda s: s.far_goals, {"gamma": 0.97}),
    # Longer sequences: a chaser with view radius 2 on 5x5 ended 0.8 % above the certified optimum
    # with these, and 1.5 % with sequences of 16 steps (1.5 M frames, seed 100).
    (
        PPOSettings,
        lambda s: s.recurrent and not s.far_evader and not s.far_goals,
        {"num_games": 512, "rollout_steps": 32, "gae_lambda": 0.95},
    ),
)
"""(class, condition, values): applied in order to hyperparameters of this class. Where `condition`
gives a share below 1, values are interpolated by that share."""


def tuned(algorithm: str, setting: TaskProfile) -> Hyperparameters:
    """Our tuned hyperparameters: the defaults of each class, changed by the profile of the task.

    The defaults were tuned on maze 5x5 with 3 goals. In larger mazes rewards are farther away, so
    that exploration is longer. See `curriculum_for` for the curriculum.

    Runners are evaluated by tour length, but the optimal tour for discounted rewards is longer: on
    5x5 with 3 goals by 0.49 % at discount 0.95 and 0 at 0.99, with 8 goals by 0.35 % at 0.99. PPO
    and DQN learn with 0.99. REINFORCE does not learn with 0.99 from the start, and a third of the
    runs of A2C end with long tours. So both anneal the discount from 0.95 to 0.99. PPO anneals it
    from 0.99 to 0.997 with many goals. Discounts are constant in races and heists.

    PPO standardises advantages. With an entropy bonus of 0.1 and a value loss of four times the
    usual weight, the final gap of runners is half as large, that of chasers a fifth. With eight
    goals some runs with this weight end with long tours.

    The standard deviation of A2C's advantages in a maze is 0.2 at first and 0.07 later. Scaling it
    to 1 would make the entropy bonus 5 to 15 times weaker: some policies became deterministic
    before they solved any episode.
    """
    hyper = hyperparameter_form(algorithm)()
    if algorithm not in HYPERPARAMETERS or hyper.SELF_PLAY_ONLY:  # their defaults are used
        return hyper
    if setting.task == "reacher" and isinstance(hyper, ActorCriticSettings):
        return tuned_for_arms(hyper, setting.joints)
    if setting.unseen_mazes and isinstance(hyper, PPOSettings):  # see docs/results/unseen_mazes.md
        hyper = replace(hyper, learning_rate=1e-3, epochs=3, minibatch_size=1024)
        return replace(hyper, gamma=0.97, entropy_coef=0.02)
    for form, where, values in TUNED_SETTINGS:
        share = float(where(setting))
        if isinstance(hyper, form) and share:
            changed = {}
            for name, far in values.items():
                near, discount = getattr(hyper, name), name.startswith("gamma")
                near = hyper.gamma if near is None else near
                changed[name] = towards(near, far, share, discount)
            hyper = replace(hyper, **changed)
    return hyper


def for_budget(hyper: Hyperparameters, frames: int) -> Hyperparameters:
    """For a budget in frames: fewer games, and as many minibatches, where few iterations fit."""
    if not isinstance(hyper, PPOSettings):
        return hyper
    steps = hyper.rollout_steps
    most = max(frames // (ITERATIONS * steps), FEWEST_GAMES)
    if hyper.num_games <= most:
        return hyper
    games, parts = 2 ** (most.bit_length() - 1), hyper.num_games * steps // hyper.minibatch_size
    return replace(hyper, num_games=games, minibatch_size=games * steps // parts)


def for_episodes(own: CurriculumSettings, episodes: float) -> CurriculumSettings:
    """A scheduled curriculum for a budget of so many episodes of `max_steps` in every game: games
    take new values at the start of an episode only."""
    if not isinstance(own, ScheduleSettings):
        return own
    least = min(CURRICULUM_EPISODES / episodes, LONGEST)
    return replace(own, schedule_length=max(own.schedule_length, least))


def tuned_for_arms(hyper: ActorCriticSettings, joints: int) -> ActorCriticSettings:
    """Tuned hyperparameters of actor-critic algorithms on an arm, with separate networks.

    Returns are far larger than in mazes, so the value loss would dominate shared hidden layers. PPO
    starts with a wide distribution and an annealed entropy bonus. After one minute with 2 joints it
    was 10.5 % above the minimum steps, and 16.2 % with a narrower distribution, no bonus and a
    discount of 0.9.
    """
    hyper = replace(hyper, shared=False, width=64)
    if not isinstance(hyper, PPOSettings):
        return replace(hyper, gamma=0.9, entropy_coef=0.0, learning_rate=3e-3)
    hyper = replace(hyper, rollout_steps=8, minibatch_size=2048, learning_rate=5e-3)
    return replace(hyper, width=128, learning_rate=2e-3) if joints > 2 else hyper


def curriculum_for(
    algorithm: str, setting: TaskProfile, preset: str = TUNED, curriculum: str | None = None
) -> tuple[str, CurriculumSettings]:
    """The named curriculum and its settings, or the curriculum of the preset.

    In large mazes random actions rarely reach goals or evaders, so the curriculum of the preset
    starts episodes near their end.

    ValueError for an unknown one.
    """
    if curriculum is not None:
        return curriculum, curriculum_form(curriculum)()
    if preset == TUNED and issubclass(hyperparameter_form(algorithm), NetworkSettings):
        if setting.far_evader and setting.duel:
            length = between(0.01, 0.2, setting.far_evader)
            return "start-distance", ScheduleSettings(schedule_length=length)
        if setting.unseen_mazes:
            return "goal-spread-start", ScheduleSettings(schedule_length=0.3)
        if setting.far_goals:
            length = between(0.01, 0.5, setting.far_goals)
            return "goal-spread-start", ScheduleSettings(schedule_length=length)
    return "none", CurriculumSettings()
