"""Policies by name in the games of a family: named ones, those of saved runs, saved models."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from pursuit.plugins import reading
from pursuit.validation import check, shortened
from train.settings.run import AgentSettings
from train.settings.task_form import TaskForm


class Fixed(NamedTuple):
    """A fixed policy of a run of self-play: its name, share of random moves, sampled or greedy."""

    name: str
    epsilon: float
    played: str


class SavedRuns(Protocol):
    """Reads saved policies; `train.runs.opponents` gives it, as runs are above this layer."""

    def settings(self, folder: Path) -> AgentSettings:
        """The settings of a run of one agent, or of one side of self-play."""

    def policy(self, folder: Path, greedy: bool) -> Any:
        """The policy of such a run, from its last checkpoint."""

    def has_distribution(self, folder: Path) -> bool:
        """Whether the algorithm of such a run learns a distribution over actions."""

    def sides(self, folder: Path) -> Mapping[str, Fixed | None] | None:
        """Of a whole run of self-play the fixed policy of each role, None of one that learns; None
        for any other folder."""

    def model(self, path: Path, greedy: bool | None, form: Any, **trained: Any) -> Any:
        """The policy of an exported or saved model in a seat of this form."""


@dataclass(frozen=True)
class NamedPolicies:
    """The policies of a family by name.

    Attributes:
        form: of the settings of the tasks in which they play.
        names: of the built-in ones.
        is_named: whether a name is that of a built-in or user-defined policy.
        named: (name, task, agent, epsilon) -> the policy.
        agents: (name, task) -> the agents or roles that the policy of this name can play;
            ValueError for none.
        placing: as `placed`.
        agent_of: (learned policy) -> its agent or role.
        models: the form of the seats of models, by the suffix of their files.
    """

    form: type[TaskForm]
    names: tuple[str, ...]
    is_named: Callable[[str], bool]
    named: Callable[[str, Any, str, float], Any]
    agents: Callable[[str, Any], tuple[str, ...]]
    placing: Callable[[Any, Any, str, str, float], Any]
    agent_of: Callable[[Any], str]
    models: Mapping[str, type[Any]]

    def placed(self, policy: Any, task: Any, agent: str, name: str, epsilon: float) -> Any:
        """The learned policy of this name as one of an agent; ValueError, which names it, where it
        does not fit."""
        try:
            return self.placing(policy, task, agent, name, epsilon)
        except ValueError as error:
            if str(error).startswith(name):
                raise
            raise ValueError(f"{name}: {error}") from None


def policy_named(
    policies: NamedPolicies,
    saved: SavedRuns,
    name: str,
    task: Any,
    agent: str,
    epsilon: float = 0.0,
    played: str = "sampled",
    observation: str | None = None,
) -> Any:
    """The policy of this name for an agent or role of a task.

    Args:
        policies: of the family.
        saved: reads saved runs.
        name: of a named policy, the folder of a run (of self-play: of all roles, also of those with
            a fixed policy), or a model (.onnx, of Stable-Baselines3 .zip).
        task, agent: the game, and the agent or role of the policy.
        epsilon: share of random moves.
        played: policy of a learned agent, "sampled" or "greedy".
        observation: of a model without a description file.

    Raises:
        ValueError: an unknown policy, or one of another game or agent.
    """
    if policies.is_named(name):
        return policies.named(name, task, agent, epsilon)
    folder = Path(name)
    sides = saved.sides(folder)
    if sides is not None:
        check_side(name, sides, agent)
        if (fixed := sides[agent]) is not None:
            how = (epsilon or fixed.epsilon, "greedy" if played == "greedy" else fixed.played)
            with reading(folder / "config.json"):
                return policy_named(policies, saved, fixed.name, task, agent, *how)
        folder /= agent
        again = f"go on with pursuit self-play --resume {name}"
        check(os.path.isdir(folder), f"{folder}: no checkpoint yet; {again}")
    trained = {"task": task, "agent": agent, "observation": observation}
    policy = loaded_policy(policies, saved, folder, played, **trained)
    return policies.placed(policy, task, agent, name, epsilon)


def check_side(name: str, sides: Mapping[str, object], agent: str) -> None:
    """ValueError unless a run of self-play has this side."""
    check(
        agent in sides,
        f"{name}: a run of self-play without a player {agent}; give a run of this game",
    )


def loaded_policy(
    policies: NamedPolicies, saved: SavedRuns, path: Path, played: str = "sampled", **trained: Any
) -> Any:
    """A policy from the folder of a run, or from the file of a model; `trained` as of
    `load_onnx` and `load_stable_baselines`.

    Raises:
        ValueError: neither of them, or damaged.
    """
    if os.path.isdir(path):  # unlike Path.is_dir() also for names that are too long
        own = saved.settings(path).task
        check(
            isinstance(own, policies.form),
            f"{path}: a run of task {own.task!r}; give a run of this game",
        )
        greedy = played == "greedy" or not saved.has_distribution(path)
        policy = saved.policy(path, greedy)
    else:
        models = f", or a model ({', '.join(policies.models)})" if policies.models else ""
        check(
            path.suffix in policies.models,
            f"{shortened(str(path))}: not a policy; give one of {', '.join(policies.names)} (or "
            f"learn, in self-play), package.module:Name, a run folder{models}",
        )
        how = None if played == "sampled" else True
        policy = saved.model(path, how, policies.models[path.suffix], **trained)
        greedy = policy.greedy
    policy.name = f"{path} ({'greedy' if greedy else 'sampled'})"
    return policy
