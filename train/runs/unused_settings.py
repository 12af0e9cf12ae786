"""Checks for settings that are changed from their default but have no effect in a run."""

from __future__ import annotations

from pursuit.tasks.rewards import ROLES, is_coefficients, rewards_from_text
from pursuit.validation import check
from train.runs.tasks import task_of
from train.settings.checks import check_default
from train.settings.self_play import SelfPlayBase, WholeSettings
from train.settings.task import AnyTask, TaskSettings


def check_unused_settings(settings: WholeSettings) -> None:
    """ValueError for a setting of a new run that is changed from its default without effect.

    Saved runs are not checked, as they may contain such settings. Nor are the runs of a sweep,
    which share settings that only some of them need.

    Args:
        settings: `TrainSettings` or `SelfPlaySettings`.
    """
    check_unused_task_settings(settings.task)
    if isinstance(settings, SelfPlayBase):
        check_unused_self_play_settings(settings)


def check_unused_task_settings(settings: AnyTask) -> None:
    """As `check_unused_settings`, for the settings of a task."""
    if not isinstance(settings, TaskSettings):
        return
    task = task_of(settings)
    if task.num_agents == 1:
        only = f"task {settings.task!r} has no other agent"
        check_default(settings, TaskSettings, ["opponent_epsilon"], only)
    given = rewards_from_text(settings.rewards) if is_coefficients(settings.rewards) else {}
    if len(given) < len(ROLES):  # coefficients without a role apply to all of them
        for role in given:
            check(
                role in task.seat_roles,
                f"rewards={settings.rewards!r}: task {settings.task!r} has no {role}; its roles "
                f"are {', '.join(dict.fromkeys(task.seat_roles))}",
            )


def check_unused_self_play_settings(settings: SelfPlayBase) -> None:
    """As `check_unused_settings`, for the settings of self-play."""
    for name, scheme in (("window", "window"), ("pfsp_power", "pfsp")):
        if settings.sampling != scheme:
            other = f"sampling={settings.sampling!r} does not use it (sampling={scheme!r} does)"
            check_default(settings, SelfPlayBase, [name], other)
    steps, most = settings.episode_steps, settings.task.max_steps
    check(
        steps is None or steps <= most,
        f"episode_steps={steps} has no effect above max_steps={most}, after which every episode is "
        f"truncated; give at most {most}, or more max_steps",
    )
