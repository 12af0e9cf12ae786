"""Stable-Baselines3's TD3, SAC, DDPG or PPO on an arm through the VecEnv, beside the least steps.

python -m train.recipes.stable_baselines_arm --algorithm td3 --joints 1 --seconds 60
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.environments.stable_baselines import StableBaselinesVecEnv
from pursuit.reacher.policy import ArmView
from pursuit.reacher.single_agent import ReacherVectorEnv
from train.commands.scores import print_bounds, print_scores
from train.evaluation.arm_contest import ArmContest
from train.recipes.common import LibraryRecipe, main_of
from train.settings.checks import EVALUATION_SEED, check, check_choice
from train.settings.task import ReacherSettings


@dataclass(frozen=True, kw_only=True)
class Recipe(LibraryRecipe):
    """Train an arm by Stable-Baselines3, and compare it with the least steps."""

    task: ReacherSettings = field(default_factory=ReacherSettings)
    algorithm: str = "td3"
    """td3, sac, ddpg or ppo."""
    observation: str = "positions"
    """positions or positions_angles."""
    games: int = 64
    """Arms in lockstep."""
    gradient_steps: int = 8
    """After each step of all arms, of those that replay."""
    seed: int = 0
    """Of the arms and of the network."""
    episodes: int = 1000
    """Of the evaluation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("algorithm", self.algorithm, ("td3", "sac", "ddpg", "ppo"))
        self.task.check_observation(self.observation)
        check(self.games >= 1 and self.gradient_steps >= 1, "games, gradient_steps: at least 1")
        check(self.episodes >= 2, f"episodes={self.episodes}; at least 2")
        check(
            self.algorithm == "ppo" or not self.task.discrete_actions,
            f"algorithm={self.algorithm!r} with discrete actions; take ppo",
        )


class Predicted:
    """A model of Stable-Baselines3 that moves an arm."""

    def __init__(self, model: Any, observation: str) -> None:
        self.model, self.observation = model, observation

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] in [-1, 1], without noise."""
        chosen, _ = self.model.predict(view.observe(self.observation), deterministic=True)
        turns = np.asarray(chosen, dtype=np.float64)
        return turns - 1.0 if view.task.discrete_actions else turns


def make_model(recipe: Recipe, envs: Any) -> Any:
    """The model, with settings that learn an arm of few joints."""
    import stable_baselines3
    from stable_baselines3.common.noise import NormalActionNoise

    settings: dict[str, Any] = {"n_steps": 32, "batch_size": 512, "n_epochs": 5}
    if recipe.algorithm != "ppo":
        settings = {
            "learning_rate": 1e-3,
            "batch_size": 256,
            "learning_starts": 5_000,
            "train_freq": 1,
            "gradient_steps": recipe.gradient_steps,
        }
    if recipe.algorithm in ("td3", "ddpg"):
        joints = recipe.task.joints
        settings["action_noise"] = NormalActionNoise(np.zeros(joints), np.full(joints, 0.2))
    return getattr(stable_baselines3, recipe.algorithm.upper())(
        "MlpPolicy",
        envs,
        seed=recipe.seed,
        device="cpu",
        gamma=0.95,
        policy_kwargs={"net_arch": [128, 128]},
        **settings,
    )


def run(recipe: Recipe) -> None:
    """Train, and compare."""
    task = recipe.task.build()
    envs = ReacherVectorEnv(task, recipe.games, recipe.observation, autoreset_mode="SAME_STEP")
    vec_env = StableBaselinesVecEnv(envs)
    vec_env.seed(recipe.seed)
    model = make_model(recipe, vec_env)
    recipe.train(model)
    if recipe.out is not None:
        model.save(recipe.out)
    contest = ArmContest(task, recipe.episodes, EVALUATION_SEED)
    learned = contest.score("learned", Predicted(model, recipe.observation))
    print(contest.line())
    print(f"Stable-Baselines3 {recipe.algorithm}: {model.num_timesteps:,} frames")
    print_scores([*contest.baselines(), learned])
    print_bounds(contest)


main = main_of(Recipe, run)

if __name__ == "__main__":
    main()
