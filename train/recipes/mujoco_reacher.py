"""Our TD3, SAC or DDPG on Gymnasium's `Reacher-v5`: a yardstick outside our world.

Published returns at 1 M frames, to stand beside: tianshou's MuJoCo benchmark, SAC -2.6, TD3 -2.7.
Needs the extra `mujoco`: pip install 'pursuit[mujoco]'.

python -m train.recipes.mujoco_reacher --algorithm td3 --frames 300000 --seed 0 --out FILE.json
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Composite, Unbounded

from train.algorithms.learner import Build
from train.algorithms.registry import entry
from train.commands.parse import fail, parse
from train.environments.hooks import EpisodeHook
from train.files import write_json
from train.machine import processor
from train.networks.features import Features
from train.settings.checks import check, check_choice, check_seed, evaluation_seed
from train.settings.off_policy import ContinuousSettings

ENVIRONMENT = "Reacher-v5"
GREEDY_EPISODES = 20
SETTINGS: dict[str, dict[str, Any]] = {
    "td3": {"learning_rate": 3e-4, "critic_learning_rate": 3e-4},
    "sac": {
        "learning_rate": 1e-3,
        "critic_learning_rate": 1e-3,
        "temperature_learning_rate": 3e-4,
        "temperature": 0.2,
        "target_entropy": -1.0,
    },
    "ddpg": {"learning_rate": 1e-3, "critic_learning_rate": 1e-3},
}
"""Those of the published runs where they name them, as far as they differ from `COMMON`."""
COMMON: dict[str, Any] = {
    "anneal": False,
    "gamma": 0.99,
    "tau": 0.005,
    "width": 256,
    "batch_size": 256,
    "buffer_size": 1_000_000,
    "max_grad_norm": 1e9,
    "noise_start": 0.1,
    "noise_end": 0.1,
}


@dataclass(frozen=True)
class Recipe:
    """Learn Gymnasium's Reacher-v5."""

    algorithm: str = "td3"
    """td3, sac or ddpg."""
    frames: int = 300_000
    """Budget, all games counted."""
    games: int = 8
    """In lockstep."""
    gradient_steps: int = 4
    """After each step of all games; the published runs took one a frame."""
    learning_starts: int = 10_000
    """Frames of random actions before the first gradient step."""
    every: int = 10_000
    """Frames between two evaluations of 20 greedy episodes."""
    seed: int = 0
    """Of the games, the network and the exploration."""
    threads: int = 1
    """Of torch."""
    out: Path | None = None
    """A new .json file for the returns."""

    def __post_init__(self) -> None:
        check_choice("algorithm", self.algorithm, SETTINGS)
        for name in ("frames", "games", "gradient_steps", "every", "threads"):
            check(getattr(self, name) >= 1, f"{name}={getattr(self, name)}; it is at least 1")
        check_seed(self.seed)
        if self.out is not None:
            check(not self.out.exists(), f"{self.out}: exists already; give a new file")

    @property
    def settings(self) -> ContinuousSettings:
        """Of the learner."""
        form: Any = entry(self.algorithm).settings
        chosen: ContinuousSettings = form(
            **COMMON,
            **SETTINGS[self.algorithm],
            num_games=self.games,
            gradient_steps=self.gradient_steps,
            learning_starts=self.learning_starts,
        )
        return chosen


class GymnasiumPlayer:
    """Who acts in a Gymnasium environment of flat observations and actions in [-1, 1].

    Raises:
        ValueError: another environment.
    """

    continuous, members, bytes_of_game = True, 1, 1_000_000

    def __init__(self, observations: Any, actions: Any) -> None:
        check(
            len(observations.shape) == 1
            and len(actions.shape) == 1
            and bool((actions.low == -1.0).all() and (actions.high == 1.0).all()),
            f"{observations} and {actions}; flat observations, and actions in [-1, 1], are needed",
        )
        self.features = Features("flat", observations.shape, np.ones(observations.shape))
        self.num_actions = actions.shape[0]

    def policy(self, network: Any, greedy: bool = True) -> Any:
        """A function of observations [games, numbers]; greedy whatever is asked."""

        def act(observed: NDArray[Any]) -> NDArray[np.float32]:
            with torch.no_grad():
                seen = torch.as_tensor(observed, dtype=torch.float32)
                acted: NDArray[np.float32] = network.act(seen, None).clamp(-1.0, 1.0).numpy()
                return acted

        return act


class GymnasiumGames:
    """A vector of Gymnasium environments as a learner's `Games`, for learners that replay.

    Args:
        name: of the environment.
        num_games: in lockstep.
        seed: of the games.

    Raises:
        ValueError: see `GymnasiumPlayer`.
    """

    def __init__(self, name: str, num_games: int, seed: int) -> None:
        mode = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.envs = gymnasium.make_vec(name, num_games, "sync", vector_kwargs=mode)
        seen, acted = self.envs.single_observation_space, self.envs.single_action_space
        self.player, self.hook = GymnasiumPlayer(seen, acted), EpisodeHook()
        self.num_games, self.resume, self._seed = num_games, False, seed
        shape: Any = (num_games, *self.player.features.shape)
        self.observation_spec = Composite(observation=Unbounded(shape), shape=(num_games,))
        self.action_spec = Bounded(-1.0, 1.0, shape=(num_games, self.player.num_actions))

    def _batch(self, observed: NDArray[Any], **content: NDArray[Any]) -> TensorDictBase:
        rows = {name: torch.from_numpy(column[:, None]) for name, column in content.items()}
        seen = torch.as_tensor(observed, dtype=torch.float32)
        return TensorDict({"observation": seen, **rows}, batch_size=[self.num_games])

    def reset(self) -> TensorDictBase:
        """Begin all games anew."""
        return self._batch(self.envs.reset(seed=self._seed)[0])

    def step_episodes(self, actions: torch.Tensor, running: torch.Tensor) -> Any:
        """Not here: the games restart by themselves."""
        raise ValueError("learners from whole episodes cannot learn here")

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """A step; "next" holds the last observation of an episode that is over."""
        actions = tensordict["action"].double().numpy()
        observed, rewards, terminated, truncated, infos = self.envs.step(actions)
        last, over = observed, terminated | truncated
        if over.any():
            last = observed.copy()
            for game in np.flatnonzero(over):
                last[game] = infos["final_obs"][game]
        flags = {"terminated": terminated, "truncated": truncated, "done": over}
        tensordict["next"] = self._batch(last, reward=rewards.astype(np.float32), **flags)
        return tensordict, self._batch(observed)


def greedy_return(policy: Any, seed: int, episodes: int = GREEDY_EPISODES) -> float:
    """The mean return of episodes of the greedy policy."""
    env, total = gymnasium.make(ENVIRONMENT), 0.0
    for episode in range(episodes):
        observed, _ = env.reset(seed=seed + episode)
        over = False
        while not over:
            step = env.step(policy(observed[None])[0].astype(np.float64))
            observed, over = step[0], step[2] or step[3]
            total += float(step[1])
    env.close()
    return total / episodes


def run(recipe: Recipe) -> dict[str, Any]:
    """Learn, print the returns as it goes on, and write them.

    Returns:
        What is written: settings, [frames, return, seconds] of every evaluation, and speed.
    """
    torch.set_num_threads(recipe.threads)
    torch.manual_seed(recipe.seed)
    settings: Any = recipe.settings
    games = GymnasiumGames(ENVIRONMENT, recipe.games, recipe.seed)
    learner: Any = entry(recipe.algorithm).build(settings, games, Build(seed=recipe.seed))
    policy, seconds = learner.policy(), 0.0
    rows: list[list[float]] = []
    seed = evaluation_seed(recipe.seed)
    while learner.frames < recipe.frames:
        began = perf_counter()
        until = min(recipe.every * (len(rows) + 1), recipe.frames)
        while learner.frames < until:
            learner.iterate(learner.frames / recipe.frames)
        seconds += perf_counter() - began
        rows.append([learner.frames, round(greedy_return(policy, seed), 3), round(seconds, 1)])
        print(f"{rows[-1][0]:>10,} frames {rows[-1][2]:>8.0f} s   return {rows[-1][1]:.2f}")
    found = {
        "environment": ENVIRONMENT,
        "algorithm": recipe.algorithm,
        "seed": recipe.seed,
        "settings": asdict(settings),
        "columns": ["frames", "return", "seconds"],
        "evaluations": rows,
        "frames_per_second": round(learner.frames / max(seconds, 1e-9), 1),
        "processor": processor(),
    }
    learner.close()
    games.envs.close()
    if recipe.out is not None:
        write_json(recipe.out, found)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line; errors are one line and exit status 2."""
    try:
        run(parse(Recipe, sys.argv[1:] if arguments is None else arguments, "recipe"))
    except (ValueError, OSError, ImportError, gymnasium.error.Error) as error:
        fail(str(error))


if __name__ == "__main__":
    main()
