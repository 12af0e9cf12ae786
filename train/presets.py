"""Settings that work, by task and size: the defaults of the command line."""

from __future__ import annotations

from train.settings import PPOSettings, TaskSettings


def ppo_preset(task: TaskSettings) -> PPOSettings:
    """Our tuned settings of PPO for this task.

    `PPOSettings` holds what was tuned on maze 5x5 with 3 goals for the time to a small gap; it
    serves chaser and evader on mazes of up to 7x7 as well. Nothing better was found for larger
    ones yet: single runs on chase 9x9 with other settings were too noisy to tell.
    """
    return PPOSettings()
