"""Checks for settings that are changed from their default but have no effect in a run."""

from __future__ import annotations

from pursuit.validation import check
from train.settings.checks import check_default
from train.settings.self_play import SelfPlayBase, WholeSettings


def check_unused_settings(settings: WholeSettings) -> None:
    """ValueError for a setting of a new run that is changed from its default without effect.

    Saved runs are not checked, as they may contain such settings. Nor are the runs of a sweep,
    which share settings that only some of them need.

    Args:
        settings: `TrainSettings` or `SelfPlaySettings`.
    """
    settings.task.check_used()
    if not isinstance(settings, SelfPlayBase):
        return
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
