"""Settings of a run that have no effect in it, and what "auto" means in it. No torch here."""

from __future__ import annotations

from typing import Any

from pursuit.observations.custom import without_id
from pursuit.validation import check
from train.files import Plain
from train.machine import uses_bfloat16
from train.settings.checks import check_default
from train.settings.self_play import SelfPlayBase, WholeSettings


def unused_settings(settings: WholeSettings) -> dict[str, str]:
    """The settings without effect in the task, or for the observation or the algorithm, by name:
    the reasons."""
    found = dict(settings.task.unused)
    if without_id(settings.observation) != "index":
        found["first_std"] = f"observation={settings.observation!r} is not index"
    if not isinstance(settings, SelfPlayBase):
        why = f"algorithm={settings.algorithm!r} does not use it"
        found |= dict.fromkeys(settings.hyper.UNUSED, why)
    return found


def check_unused_settings(settings: WholeSettings) -> None:
    """ValueError for a setting of a new run that is changed from its default without effect.

    Saved runs are not checked, as they may contain such settings. Nor are the runs of a sweep,
    which share settings that only some of them need.

    Args:
        settings: `TrainSettings` or `SelfPlaySettings`.
    """
    settings.task.check_used()
    given: Any = settings
    for name, why in unused_settings(settings).items():
        for part in (given, *settings.learners):
            if name in vars(part):
                check_default(part, type(part), [name], why)
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


def resolved_settings(settings: WholeSettings) -> Plain:
    """What those settings mean in a run on this machine that are "auto", or 0 threads, by name.

    What is chosen later is left out: threads with a budget in seconds, networks in games of the
    user, logs. `update` in `results.json` says what `fused` came to.
    """
    task, found = settings.task, Plain()
    if not isinstance(settings, SelfPlayBase):
        found["threads"] = 0 if settings.threads else settings.fixed_threads
        if vars(task).get(task.AGENT) == "auto":
            found[task.AGENT] = task.agent_in(task.build())
    if settings.network == "auto":
        found["network"] = task.usual_network(settings.observation, settings.device)
    if settings.precision == "auto":
        fast = uses_bfloat16("auto", settings.device)
        found["precision"] = "bfloat16" if fast else "float32"
    unused = unused_settings(settings)
    return {n: value for n, value in found.items() if n not in unused and value not in (0, "auto")}
