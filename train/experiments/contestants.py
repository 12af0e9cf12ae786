"""Learners of several libraries, for comparisons, each with its native environment API.

All have the same settings (those of PPO, with the defaults of their library) and the same one-hot
observation: own cell, cells of the others, goals. All anneal the learning rate to 0 over the budget
and have two hidden layers. Features of a library are not switched off. Ours sums the rows of its
first layer, shares this layer between policy and value, uses bfloat16 if the processor supports
it, and uses a curriculum in large mazes.

A further library is an entry of `CONTESTANTS`: a function that makes a `Trainer`, which obeys all
settings of `OBEYED`, uses one thread, and takes its seed. It also needs an extra in
`pyproject.toml`, and its name in `[grid] contestant` of a file (`files/comparisons/ppo.toml`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Protocol

from torch import nn

import pursuit
from pursuit.environments.single_agent import SingleAgentVectorEnv
from pursuit.simulator.policy import Policy
from train.experiments.plain_ppo import PlainPPO
from train.families.maze import GridWorld
from train.networks.policy import MazeSeat
from train.runs.parts import parts_of
from train.runs.single import SingleAgent
from train.runs.stable_baselines import StableBaselinesNetwork
from train.runs.threads import prepare_torch
from train.settings.algorithms import PPOSettings
from train.settings.presets import curriculum_for, tuned
from train.settings.run import TrainSettings

OBSERVATION = "one_hot"
OBEYED = (
    *("num_games", "rollout_steps", "minibatch_size", "epochs", "learning_rate", "gamma"),
    *("gae_lambda", "clip", "entropy_coef", "value_coef", "max_grad_norm", "width", "activation"),
)
"""The settings that every contestant implements; a search may draw these."""


class Trainer(Protocol):
    """A learner of one library, with its environments and initial weights."""

    @property
    def frames(self) -> int:
        """Environment steps so far, summed over all games."""

    def iterate(self, progress: float) -> None:
        """A rollout and an update; `progress` in [0, 1] is the used share of the budget."""

    def policy(self, greedy: bool) -> Policy:
        """The current policy; later updates change it."""

    def close(self) -> None:
        """Release resources."""


# -- ours ------------------------------------------------------------------------------------------


class Ours:
    """PPO of `pursuit train`, by default with the curriculum of its preset if there is one.

    It is the `Clock` of its learner, as the comparison counts the budget.
    """

    def __init__(
        self, world: GridWorld, settings: PPOSettings, seed: int, curriculum: str | None = None
    ) -> None:
        prepare_torch(1, seed)
        name, own = curriculum_for("ppo", world.settings.profile(), curriculum=curriculum)
        # Frames are given so that threads are not chosen by time.
        whole = TrainSettings(
            world.settings, settings, own, "ppo", name, frames=10**12, seed=seed, threads=1
        )
        self.learner = SingleAgent(parts_of(whole), "greedy")
        self.progress = self.seconds = 0.0

    @property
    def frames(self) -> int:
        """As `Trainer`."""
        return int(self.learner.frames)

    def iterate(self, progress: float) -> None:
        """As `Trainer`."""
        self.progress = progress
        self.learner.iterate(self)
        # Not used here; they would accumulate.
        self.learner.env.finished_returns.clear()
        self.learner.env.finished_lengths.clear()

    def policy(self, greedy: bool) -> Policy:
        """As `Trainer`."""
        return self.learner.learner.policy(greedy=greedy)

    def close(self) -> None:
        """As `Trainer`."""
        self.learner.close()


def our_defaults(world: GridWorld) -> PPOSettings:
    """Our preset of a task."""
    found = tuned("ppo", world.settings.profile())
    assert isinstance(found, PPOSettings)
    return found


# -- the others ------------------------------------------------------------------------------------


def vector_env(world: GridWorld, games: int) -> SingleAgentVectorEnv:
    """Games as a Gymnasium vector environment that start again in the step that ends them."""
    seats = (world.task, world.agent, world.opponents)
    return SingleAgentVectorEnv(*seats, games, OBSERVATION, autoreset_mode="SAME_STEP")


class CleanRL:
    """`PlainPPO`: the loop of CleanRL."""

    def __init__(self, world: GridWorld, settings: PPOSettings, seed: int) -> None:
        self.world = world
        self.learner = PlainPPO(settings, vector_env(world, settings.num_games), seed)

    @property
    def frames(self) -> int:
        """As `Trainer`."""
        return self.learner.frames

    def iterate(self, progress: float) -> None:
        """As `Trainer`."""
        self.learner.iterate(progress)

    def policy(self, greedy: bool) -> Policy:
        """As `Trainer`."""
        seat = MazeSeat(self.world.task, self.world.agent, OBSERVATION)
        return seat.policy(self.learner.network, greedy)

    def close(self) -> None:
        """As `Trainer`."""


class StableBaselines:
    """Stable-Baselines3's PPO with an MlpPolicy."""

    def __init__(self, world: GridWorld, settings: PPOSettings, seed: int) -> None:
        from stable_baselines3 import PPO
        from stable_baselines3.common.logger import Logger

        from pursuit.environments.stable_baselines import StableBaselinesVecEnv

        self.world, self.progress = world, 0.0
        self.batch = settings.num_games * settings.rollout_steps
        between = nn.Tanh if settings.activation == "tanh" else nn.ReLU
        self.learner = PPO(
            "MlpPolicy",
            StableBaselinesVecEnv(vector_env(world, settings.num_games)),
            n_steps=settings.rollout_steps,
            batch_size=settings.minibatch_size,
            n_epochs=settings.epochs,
            learning_rate=lambda _: settings.learning_rate * (1.0 - self.progress),
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip,
            ent_coef=settings.entropy_coef,
            vf_coef=settings.value_coef,
            max_grad_norm=settings.max_grad_norm,
            policy_kwargs={"net_arch": [settings.width] * 2, "activation_fn": between},
            seed=seed,
            device="cpu",
        )
        # Without a logger every rollout creates a log folder.
        self.learner.set_logger(Logger(folder=None, output_formats=[]))

        self.network = StableBaselinesNetwork(self.learner.policy)

    @property
    def frames(self) -> int:
        """As `Trainer`."""
        return int(self.learner.num_timesteps)

    def iterate(self, progress: float) -> None:
        """As `Trainer`."""
        self.progress = progress
        self.learner.learn(self.batch, reset_num_timesteps=False)

    def policy(self, greedy: bool) -> Policy:
        """As `Trainer`."""
        return MazeSeat(self.world.task, self.world.agent, OBSERVATION).policy(self.network, greedy)

    def close(self) -> None:
        """As `Trainer`."""


# -- the list --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contestant:
    """A library in the comparison.

    Attributes:
        title: name in reports.
        package: the required package, whose version is recorded.
        extra: the extra of `pip install 'pursuit[...]'` that installs it.
        build: makes a new `Trainer` from a world, settings and a seed.
        defaults: makes the settings that a search starts from.
    """

    title: str
    package: str
    extra: str
    build: Callable[[GridWorld, PPOSettings, int], Trainer]
    defaults: Callable[[GridWorld], PPOSettings]

    @property
    def version(self) -> str:
        """The version of its package; ImportError if it is not installed."""
        if self.package == "pursuit":
            return str(pursuit.__version__)
        try:
            return version(self.package)
        except PackageNotFoundError:
            raise ImportError(
                f"{self.package} is not installed; pip install 'pursuit[{self.extra}]', or leave "
                f"{self.title} out of contestants"
            ) from None


LIBRARY_DEFAULTS = PPOSettings(
    shared=False, activation="tanh", clip=0.2, max_grad_norm=0.5, value_coef=0.5
)
"""Defaults of the libraries for settings that a search leaves out."""
CONTESTANTS = {
    "ours": Contestant("ours", "pursuit", "", Ours, our_defaults),
    "ours, no curriculum": Contestant(
        "ours, no curriculum", "pursuit", "", partial(Ours, curriculum="none"), our_defaults
    ),
    "cleanrl": Contestant("CleanRL's loop", "torch", "", CleanRL, lambda _: LIBRARY_DEFAULTS),
    "stable-baselines3": Contestant(
        "Stable-Baselines3", "stable_baselines3", "sb3", StableBaselines, lambda _: LIBRARY_DEFAULTS
    ),
}
"""By their names in comparison files."""
