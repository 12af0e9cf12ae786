"""Stable-Baselines3's PPO, A2C or DQN through the VecEnv, compared with the exact optimum.

    python -m train.recipes.stable_baselines --algorithm ppo --maze 5x5 --seconds 60 --out ppo.zip

Train against the saved model: pursuit train --role evader --maze 5x5 --opponent ppo.zip
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pursuit.environments.stable_baselines import StableBaselinesVecEnv
from pursuit.validation import one_of
from train.commands.scores import print_scores
from train.experiments.contestants import vector_env
from train.recipes.common import LibraryRecipe, main_of
from train.runs.parts import contest_of
from train.runs.stable_baselines import load_stable_baselines, save_stable_baselines
from train.settings.checks import check
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
"""Settings for games in mazes, by algorithm."""


@dataclass(frozen=True, kw_only=True)
class Recipe(LibraryRecipe):
    """Train one agent by Stable-Baselines3, and compare it with the exact optimum."""

    task: TaskSettings = field(default_factory=TaskSettings)
    algorithm: str = "ppo"
    """ppo, a2c or dqn."""
    observation: str = "one_hot"
    """Observation of the model; not index, which needs an embedding."""
    seed: int = 0
    """Seed of the games and of the network."""
    out: Path = Path("model.zip")
    """A new .zip file for the model; its description file is written next to it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("algorithm", self.algorithm, SETTINGS)
        check(self.observation != "index", "observation='index'; use one_hot, as for any MlpPolicy")
        check(
            not self.task.mask_bumps,
            "mask_bumps=True is not supported by these learners; leave it out, or train "
            "sb3-contrib's MaskablePPO with StableBaselinesVecEnv",
        )


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
        device="cpu",  # faster for small networks
        gamma=0.95,
        policy_kwargs={"net_arch": [128, 128]},
        **SETTINGS[recipe.algorithm],
    )
    recipe.train(model)
    save_stable_baselines(model, recipe.out, recipe.algorithm, recipe.task, recipe.observation)
    policy = load_stable_baselines(recipe.out)
    print(contest.line())
    print(f"Stable-Baselines3 {recipe.algorithm}: {model.num_timesteps:,} frames")
    scores = [*contest.baselines(), contest.score("learned", policy)]
    print_scores(scores, contest)


main = main_of(Recipe, run)

if __name__ == "__main__":
    main()
