"""Parameter sharing through PettingZoo, SuperSuit and Stable-Baselines3: two runners, one network.

    python -m train.recipes.supersuit_sharing --maze 5x5 --seconds 60 --out runners.zip

SuperSuit's vector environment treats every agent as an environment, so that one PPO learns from all
agents. This is valid if all agents have one role and their observations start with their own cell,
as in a race. SuperSuit cannot be seeded, and reports truncation as termination, so that values are
not bootstrapped at the time limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pursuit import race_v0
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from scripted_agents import NearestGoalRunner, RandomAgent
from train.recipes.common import LibraryRecipe, main_of
from train.runs.stable_baselines import load_stable_baselines, save_stable_baselines
from train.runs.tasks import task_of
from train.settings.checks import EVALUATION_SEED, check
from train.settings.task import TaskSettings


@dataclass(frozen=True, kw_only=True)
class Recipe(LibraryRecipe):
    """Train two runners that share one network, and compare them with scripted ones."""

    maze: str = "5x5"
    """A shipped maze, or the path of a maze file."""
    num_goals: int = 3
    """Number of goals."""
    games: int = 16
    """Number of games, which SuperSuit steps in sequence."""
    out: Path = Path("runners.zip")
    """A new .zip file for the model; its description file is written next to it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self.games >= 1, f"games={self.games}; give at least 1")

    @property
    def task(self) -> TaskSettings:
        """The race."""
        return TaskSettings("race", maze=self.maze, num_runners=2, num_goals=self.num_goals)


def mean_length(task: TaskSettings, policy: Policy, episodes: int = 1000) -> float:
    """Mean episode length if all agents play `policy`, from the starts of all evaluations."""
    built = task_of(task)
    simulator = Simulator(built, episodes, EVALUATION_SEED, auto_restart=False)
    actions = np.zeros((episodes, built.num_agents), dtype=np.int32)
    while not simulator.ended.all():
        simulator.act([policy] * built.num_agents, actions)
        simulator.step(actions)
    return float(simulator.steps.mean())


def run(recipe: Recipe) -> None:
    """Train, save, load the weights again, and compare."""
    import supersuit
    from stable_baselines3 import PPO

    env = race_v0.parallel_env(
        maze=task_of(recipe.task).mazes[0],
        num_runners=2,
        num_goals=recipe.num_goals,
        observation="one_hot",
    )
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    envs: Any = supersuit.concat_vec_envs_v1(env, recipe.games, base_class="stable_baselines3")
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=64,
        batch_size=512,
        n_epochs=4,
        learning_rate=2e-3,
        gamma=0.95,
        ent_coef=0.01,
        policy_kwargs={"net_arch": [128, 128]},
        # No seed: Stable-Baselines3 would also seed the environments, which SuperSuit cannot do.
        device="cpu",
    )
    recipe.train(model)
    save_stable_baselines(model, recipe.out, "ppo", recipe.task, "one_hot")
    print(
        f"race on {recipe.maze}, 2 runners, {recipe.num_goals} goals; all agents share one policy"
    )
    print(f"{model.num_timesteps:,} frames of single agents")
    learned = load_stable_baselines(recipe.out, greedy=False)
    policies: tuple[tuple[str, Policy], ...] = (
        ("random", RandomAgent()),
        ("nearest goal", NearestGoalRunner()),
        ("learned, shared, sampled", learned),
    )
    for name, policy in policies:
        print(f"{name:<26}{mean_length(recipe.task, policy):8.2f} steps")


main = main_of(Recipe, run)

if __name__ == "__main__":
    main()
