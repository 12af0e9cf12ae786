"""The hyperparameters of the learners of self-play; imported without torch by the command line."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from train.runs.tasks import profile_of
from train.settings.algorithms import Hyperparameters
from train.settings.presets import hyperparameters
from train.settings.self_play import SelfPlaySettings


def hyper_of(settings: SelfPlaySettings, role: str) -> Hyperparameters:
    """The hyperparameters of a role that learns.

    Those of PPO are in `hyper`, those of other algorithms in `chaser_hyper` and `evader_hyper`. If
    these are None they are the tuned ones, with the discount and the memory of `hyper`.
    """
    own = getattr(settings, f"{role}_hyper") if role in settings.other_learners else settings.hyper
    if own is not None:
        return own
    hyper = hyperparameters(settings.algorithm(role), profile_of(replace(settings.task, role=role)))
    same = {name: getattr(settings.hyper, name) for name in ("gamma", "gamma_end", "recurrent")}
    if "gamma_end" not in {field.name for field in fields(hyper)}:
        del same["gamma_end"]
        same["gamma"] = settings.discount  # that of the exact game
    return replace(hyper, **same)


def complete(settings: SelfPlaySettings) -> SelfPlaySettings:
    """The settings with the hyperparameters of all learners and no others, as in `config.json`."""
    others: Any = {f"{role}_hyper": hyper_of(settings, role) for role in settings.other_learners}
    ppo = len(others) < len(settings.learning)
    return replace(settings, hyper=settings.hyper if ppo else None, **others)
