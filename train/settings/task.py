"""What is played, and against whom, by name."""

from __future__ import annotations

from dataclasses import dataclass

from pursuit.rewards import kept_rewards, rewards_text
from pursuit.task import TASK_NAMES
from train.settings.checks import check, check_choice

OPPONENT_POLICIES = ("sampled", "greedy")


@dataclass(frozen=True)
class TaskSettings:
    """What is played, and against whom."""

    task: str = "chase"
    """chase, maze, race or heist."""
    role: str = "auto"
    """Who learns: chaser, evader or runner (or one agent, such as chaser_1). auto: the first."""
    maze: str = "5x5"
    """A shipped maze (2x2 ... 9x9, 15x15, also -tree and -open), or the path of a maze file."""
    num_chasers: int | None = None
    """Chasers; the task's own number if left out."""
    num_evaders: int | None = None
    """Evaders; likewise."""
    num_runners: int | None = None
    """Runners; likewise."""
    num_goals: int | None = None
    """Goals; likewise."""
    max_steps: int = 200
    """An episode of this many steps is truncated."""
    stay_action: bool = False
    """Whether a fifth action, stay, exists."""
    move_order: str = "simultaneous"
    """simultaneous, or chasers_first."""
    min_start_distance: int = 1
    """Steps between chasers and evaders at the start, at least."""
    rewards: str = "default"
    """goal, completion, distance, zero_sum, or the task's own (default); coefficients, such as
    step=-0.1,capture=2 or chaser.step=-0.1,evader.capture=-2 (of step, capture, goal, distance,
    on_completion); or package.module:Name of a function of your own."""
    opponent_epsilon: float = 0.2
    """Share of random moves of the scripted agents in all other seats, in [0, 1]."""
    opponent: str | None = None
    """Who plays the other side instead of A*: random, optimal (exactly), the folder of a run, a
    saved Stable-Baselines3 model (.zip), or package.module:Name of your own. Learned ones play as
    opponent_policy says."""
    opponent_policy: str = "sampled"
    """How a learned opponent plays: sampled (as it was learned, where it is a distribution), or
    greedy (always the most probable action)."""
    start: str = "random"
    """random, or marks: the S and G of the maze (fixed goals)."""
    mask_bumps: bool = False
    """Forbid the learner moves into walls, as it learns and as it plays. Without the stay action
    they are the only way to wait, which the best chasers and evaders do."""

    def __post_init__(self) -> None:
        check(
            0.0 <= self.opponent_epsilon <= 1.0,
            f"opponent_epsilon={self.opponent_epsilon}; a share of random moves lies in [0, 1]",
        )
        check_choice("task", self.task, TASK_NAMES)
        check_choice("opponent_policy", self.opponent_policy, OPPONENT_POLICIES)
        object.__setattr__(self, "rewards", rewards_text(self.rewards))
        if self.rewards != "default":
            kept_rewards("rewards", self.rewards)

    @property
    def agent(self) -> str:
        """Who learns."""
        return who_learns(self.task, self.role)


def who_learns(task: str, role: str) -> str:
    """The role that is named, or the first of a task for "auto"."""
    if role != "auto":
        return role
    return "runner" if task in ("maze", "race") else "chaser"
