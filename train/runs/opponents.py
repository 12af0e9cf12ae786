"""Policies by name: scripted agents, saved runs, models of other libraries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pursuit.declared import truth
from pursuit.policy import Policy
from pursuit.task import Task
from scripted_agents.environments import (
    AGENTS,
    check_agent,
    default_policies,
    is_own_policy,
    own_policy,
    scripted_policy,
)
from train.algorithms.registry import entry
from train.runs.folder import MISFITS, load_checkpoint, misfit, part_of
from train.runs.saved import load_settings
from train.runs.tasks import player_of
from train.runs.third_party import load_stable_baselines
from train.settings.checks import check
from train.settings.task import in_maze


def load_policy(folder: Path | str, greedy: bool = True) -> Any:
    """The policy of a run, from its last checkpoint, on the CPU: a `Policy` of its role.

    Args:
        folder: of the run; of self-play its `chaser` or `evader`.
        greedy: take the most probable action; False draws, as it was learned.

    Raises:
        ValueError: no run, a damaged one, or one without the distribution asked for; or `greedy`
            is no truth value.
    """
    folder, greedy = Path(folder), truth("greedy", greedy)
    settings, state = load_settings(folder), load_checkpoint(folder)
    algorithm = entry(settings.algorithm)
    check(
        greedy or algorithm.learns_distribution,
        f"{folder}: {settings.algorithm} learns no distribution over actions; take greedy=True",
    )
    seat = player_of(settings)
    try:
        learner = part_of(state, "trainee", "learner")
        return algorithm.load(settings.hyper, seat, learner, greedy)
    except MISFITS as error:
        raise misfit(folder, error) from None


def load_opponent(path: Path | str, played: str = "sampled", **trained: Any) -> Policy:
    """A policy from the folder of a run, or from a saved Stable-Baselines3 model.

    Args:
        path: of either.
        played: "sampled", as it was learned, where it is a distribution; or "greedy".
        **trained: task, agent and observation of a model without a description beside it, as
            `load_stable_baselines` takes them.

    Raises:
        ValueError: neither, or damaged.
    """
    path = Path(path)
    if path.is_dir():
        settings = load_settings(path)
        in_maze(settings.task, str(path))
        sampled = entry(settings.algorithm).learns_distribution
        return load_policy(path, played == "greedy" or not sampled)
    check(
        path.suffix == ".zip",
        f"{path}: no policy; give the folder of a run, or a saved Stable-Baselines3 model (.zip)",
    )
    return load_stable_baselines(path, None if played == "sampled" else True, **trained)


def opponents_of(
    task: Task,
    agent: str,
    opponent: str | None,
    epsilon: float,
    played: str = "sampled",
    observation: str | None = None,
) -> dict[str, Policy]:
    """The policy of every role: scripted, and where there is one, `opponent` for its own.

    Args:
        task: the game.
        agent: who learns.
        opponent: one of AGENTS, a user's own policy, the folder of a run or a model's .zip; None
            for A*.
        epsilon: share of random moves of the scripted agents.
        played: how a learned opponent plays, "sampled" or "greedy".
        observation: what a model observes that has no description beside it.

    Raises:
        ValueError: no policy at `opponent`, or one that cannot play against the learner.
    """
    policies = default_policies(task, epsilon, own=agent)
    if opponent in AGENTS:
        roles = set(task.seat_roles) - {agent.split("_")[0]}
        check(
            bool(roles),
            f"opponent={opponent!r}, but task {task.name!r} has nobody of another role; leave it "
            "out",
        )
        for other in roles:
            check_agent(str(opponent), task, other)
            rest: Any = (epsilon, task.move_order)
            policies[other] = scripted_policy(str(opponent), other, *rest)
    elif opponent is not None and is_own_policy(opponent):
        check(
            task.num_agents > 1,
            f"opponent={opponent!r}; task {task.name!r} has no other seats; leave it out",
        )
        learner = agent.split("_")[0]
        for other in set(task.seat_roles) - {learner} or {learner}:
            policies[other] = own_policy(opponent, task, other)
    elif opponent is not None:
        seat = task.seat(agent)
        others = [r for s, r in enumerate(task.seat_roles) if s != seat]
        first = next((r for r in others if r != task.seat_roles[seat]), task.seat_roles[seat])
        trained = {"task": task, "agent": first, "observation": observation}
        policy: Any = load_opponent(opponent, played, **trained)
        role = role_of(policy)
        check(
            role in others,
            f"opponent={opponent!r} learned to be {role!r}; the other seats of task "
            f"{task.name!r} are {', '.join(others) or 'none'}; give a policy of another role",
        )
        policies[role] = policy
    return policies


def role_of(policy: Any) -> str:
    """The role that a learned policy learned."""
    task: Task = policy.task
    return task.seat_roles[task.seat(policy.agent)]


def check_fits(policy: Policy, role: str, task: Task, name: str) -> None:
    """Raise ValueError unless a learned policy is of this role and of games like these."""
    if not hasattr(policy, "task"):
        return
    own: Task = policy.task
    learned = role_of(policy)
    check(learned == role, f"{name}: learned to be {learned!r}; {role!r} is asked for")
    plays_in = getattr(policy, "plays_in", lambda maze: False)
    check(
        set(task.mazes) <= set(own.mazes) or all(plays_in(maze) for maze in task.mazes),
        f"{name}: learned in maze {own.mazes[0].name}, and the games are in {task.mazes[0].name}",
    )
    for what in ("num_chasers", "num_evaders", "num_goals", "stay_action", "move_order"):
        mine, theirs = getattr(own, what), getattr(task, what)
        check(mine == theirs, f"{name}: learned with {what}={mine}; the games have {theirs}")
