"""Stable-Baselines3's PPO, A2C or DQN through the VecEnv, beside the exact optimum.

    python -m train.recipes.stable_baselines --algorithm ppo --maze 5x5 --seconds 60 --out ppo.zip

The saved model fills an opponent's seat: pursuit train --role evader --maze 5x5 --opponent ppo.zip
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from pursuit.environments.stable_baselines import StableBaselinesVecEnv
from train.commands.parse import fail, parse
from train.commands.scores import print_scores
from train.experiments.comparison.contestants import vector_env
from train.runs.parts import contest_of
from train.runs.third_party import load_stable_baselines, save_stable_baselines
from train.settings.checks import check, check_choice
from train.settings.task import TaskSettings

SETTINGS: dict[str, dict[str, Any]] = {
    "ppo": {
        "n_steps": 32,
        "batch_size": 1024,
        "n_epochs": 4,
        "learning_rate": 2e-3,
        "ent_coef": 0.01,
    },
    "a2c": {"n_steps": 8},
    "dqn": {
        "learning_rate": 1e-3,
        "buffer_size": 200_000,
        "learning_starts": 5_000,
        "batch_size": 512,
        "train_freq": 1,
        "gradient_steps": 1,
        "target_update_interval": 2_000,
        "exploration_fraction": 0.1,
    },
}
"""By algorithm: settings that learn these games."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Train one agent by Stable-Baselines3, and compare it with the exact optimum."""

    seconds: float = 60.0
    """Budget of training time."""
    frames: int | None = None
    """Budget in frames instead, which repeats better than seconds."""
    task: TaskSettings = field(default_factory=TaskSettings)
    algorithm: str = "ppo"
    """ppo, a2c or dqn."""
    observation: str = "one_hot"
    """What it observes; the index encoding needs an embedding, which MlpPolicy has not."""
    seed: int = 0
    """Of the games and of the network."""
    out: Path = Path("model.zip")
    """A new .zip file for the model; its description goes beside it."""

    def __post_init__(self) -> None:
        check(self.seconds > 0, f"seconds={self.seconds}; it is above 0")
        check(self.frames is None or self.frames > 0, f"frames={self.frames}; it is above 0")
        check(self.out.suffix == ".zip", f"{self.out}: give a .zip file")
        check(not self.out.exists(), f"{self.out}: exists already; give a new file")
        check_choice("algorithm", self.algorithm, SETTINGS)
        check(self.observation != "index", "observation='index'; MlpPolicy needs one_hot, say")
        check(
            not self.task.mask_bumps,
            "mask_bumps=True; these learners know no masks: leave it out, or train sb3-contrib's "
            "MaskablePPO over StableBaselinesVecEnv",
        )


def learn(model: Any, recipe: Recipe) -> None:
    """Have a model learn until the budget is spent."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Budget(BaseCallback):
        """Ends the training when its time is over."""

        began = 0.0

        def _on_training_start(self) -> None:
            self.began = perf_counter()

        def _on_step(self) -> bool:
            return bool(recipe.frames) or perf_counter() - self.began < recipe.seconds

    model.learn(recipe.frames or 10**12, callback=Budget())


def run(recipe: Recipe) -> None:
    """Train, save, load the weights again, and compare."""
    import stable_baselines3

    contest = contest_of(recipe.task, 1000)
    games = 32 if recipe.algorithm == "dqn" else 64
    vec_env = StableBaselinesVecEnv(vector_env(contest, games, recipe.observation))
    vec_env.seed(recipe.seed)
    model = getattr(stable_baselines3, recipe.algorithm.upper())(
        "MlpPolicy",
        vec_env,
        seed=recipe.seed,
        device="cpu",  # small networks are best there
        gamma=0.95,
        policy_kwargs={"net_arch": [128, 128]},
        **SETTINGS[recipe.algorithm],
    )
    learn(model, recipe)
    save_stable_baselines(model, recipe.out, recipe.algorithm, recipe.task, recipe.observation)
    policy = load_stable_baselines(recipe.out)
    print(contest.line())
    print(f"Stable-Baselines3 {recipe.algorithm}: {model.num_timesteps:,} frames")
    scores = [*contest.baselines(), contest.score("learned", policy)]
    print_scores(scores, measure=contest.measure)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line: errors are one line and exit status 2."""
    try:
        run(parse(Recipe, sys.argv[1:] if arguments is None else arguments, "recipe"))
    except (ValueError, OSError, ImportError) as error:
        fail(str(error))


if __name__ == "__main__":
    main()
