"""Stable-Baselines3's TD3, SAC, DDPG or PPO on an arm through the VecEnv, beside the least steps.

python -m train.recipes.stable_baselines_arm --algorithm td3 --joints 1 --seconds 60
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.policy import ArmView
from pursuit.reacher.single_agent import ReacherVectorEnv
from pursuit.stable_baselines import StableBaselinesVecEnv
from train.commands.parse import fail, parse
from train.commands.scores import print_bounds, print_scores
from train.evaluation.arm_contest import ArmContest
from train.settings.checks import EVALUATION_SEED, check, check_choice
from train.settings.task import ReacherSettings


@dataclass(frozen=True)
class Recipe:
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
    seconds: float = 60.0
    """Budget of training time."""
    frames: int | None = None
    """Budget in frames instead, which repeats better than seconds."""
    seed: int = 0
    """Of the arms and of the network."""
    episodes: int = 1000
    """Of the evaluation."""
    out: Path | None = None
    """A new .zip file for the model."""

    def __post_init__(self) -> None:
        check_choice("algorithm", self.algorithm, ("td3", "sac", "ddpg", "ppo"))
        self.task.check_observation(self.observation)
        check(self.games >= 1 and self.gradient_steps >= 1, "games, gradient_steps: at least 1")
        check(self.seconds > 0, f"seconds={self.seconds}; it is above 0")
        check(self.frames is None or self.frames > 0, f"frames={self.frames}; it is above 0")
        check(self.episodes >= 2, f"episodes={self.episodes}; at least 2")
        check(
            self.algorithm == "ppo" or not self.task.discrete_actions,
            f"algorithm={self.algorithm!r} with discrete actions; take ppo",
        )
        if self.out is not None:
            check(self.out.suffix == ".zip", f"{self.out}: give a .zip file")
            check(not self.out.exists(), f"{self.out}: exists already; give a new file")


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
    from stable_baselines3 import DDPG, PPO, SAC, TD3
    from stable_baselines3.common.noise import NormalActionNoise

    common: dict[str, Any] = {"seed": recipe.seed, "device": "cpu", "gamma": 0.95}
    common["policy_kwargs"] = {"net_arch": [128, 128]}
    if recipe.algorithm == "ppo":
        return PPO("MlpPolicy", envs, n_steps=32, batch_size=512, n_epochs=5, **common)
    common |= {
        "learning_rate": 1e-3,
        "batch_size": 256,
        "learning_starts": 5_000,
        "train_freq": 1,
        "gradient_steps": recipe.gradient_steps,
    }
    if recipe.algorithm == "sac":
        return SAC("MlpPolicy", envs, **common)
    joints = recipe.task.joints
    noise = NormalActionNoise(np.zeros(joints), np.full(joints, 0.2))
    form = TD3 if recipe.algorithm == "td3" else DDPG
    return form("MlpPolicy", envs, action_noise=noise, **common)


def run(recipe: Recipe) -> None:
    """Train, and compare."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Budget(BaseCallback):
        """Ends the training when its time is over."""

        began = 0.0

        def _on_training_start(self) -> None:
            self.began = perf_counter()

        def _on_step(self) -> bool:
            return bool(recipe.frames) or perf_counter() - self.began < recipe.seconds

    task = recipe.task.build()
    envs = ReacherVectorEnv(task, recipe.games, recipe.observation, autoreset_mode="SAME_STEP")
    vec_env = StableBaselinesVecEnv(envs)
    vec_env.seed(recipe.seed)
    model = make_model(recipe, vec_env)
    model.learn(recipe.frames or 10**12, callback=Budget())
    if recipe.out is not None:
        model.save(recipe.out)
    contest = ArmContest(task, recipe.episodes, EVALUATION_SEED)
    learned = contest.score("learned", Predicted(model, recipe.observation))
    print(contest.line())
    print(f"Stable-Baselines3 {recipe.algorithm}: {model.num_timesteps:,} frames")
    print_scores([*contest.baselines(), learned])
    print_bounds(contest)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line; errors are one line and exit status 2."""
    try:
        run(parse(Recipe, sys.argv[1:] if arguments is None else arguments, "recipe"))
    except (ValueError, OSError, ImportError) as error:
        fail(str(error))


if __name__ == "__main__":
    main()
