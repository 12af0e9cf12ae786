"""Policies by name: scripted agents, saved runs, models of other libraries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pursuit.policy import Policy
from pursuit.task import Task
from scripted_agents.environments import SCRIPTED, default_policies, scripted_policy
from train.algorithms.registry import entry
from train.networks.policy import Seat
from train.runs.folder import MISFITS, load_checkpoint, misfit, part_of
from train.runs.saved import load_settings
from train.runs.tasks import agent_of, task_of
from train.runs.third_party import load_stable_baselines
from train.settings.checks import check
from train.teaching.plan import training_task


def load_policy(folder: Path, greedy: bool = True) -> Policy:
    """The policy of a run, from its last checkpoint, on the CPU.

    Raises:
        ValueError: no run, a damaged one, or one without the distribution asked for.
    """
    settings, state = load_settings(folder), load_checkpoint(folder)
    algorithm = entry(settings.algorithm)
    check(
        greedy or algorithm.learns_distribution,
        f"{folder}: {settings.algorithm} learns no distribution over actions; take greedy=True",
    )
    task = task_of(settings.task)
    agent = agent_of(settings.task, task)
    seat = Seat(
        training_task(settings.curriculum, settings.lessons, task),
        agent,
        settings.observation,
    )
    try:
        learner = part_of(state, "trainee", "learner")
        return algorithm.load(settings.hyper, seat, learner, greedy)
    except MISFITS as error:
        raise misfit(folder, error) from None


def load_sampled(folder: Path) -> Policy:
    """The policy of a run as it was learned: sampled, where there is a distribution."""
    return load_policy(folder, not entry(load_settings(folder).algorithm).learns_distribution)


def load_opponent(path: Path) -> Policy:
    """A policy from the folder of a run, or from a saved Stable-Baselines3 model.

    Raises:
        ValueError: neither, or damaged.
    """
    if path.is_dir():
        return load_policy(path)
    check(
        path.suffix == ".zip",
        f"{path}: no policy; give the folder of a run, or a saved Stable-Baselines3 model (.zip)",
    )
    return load_stable_baselines(path)


def opponents_of(task: Task, agent: str, opponent: str | None, epsilon: float) -> dict[str, Policy]:
    """The policy of every role: scripted, and where there is one, `opponent` for its own.

    Args:
        task: the game.
        agent: who learns.
        opponent: random, optimal, astar, the folder of a run or a model's .zip; None for A*.
        epsilon: share of random moves of the scripted agents.

    Raises:
        ValueError: no policy at `opponent`, or one that cannot play against the learner.
    """
    policies = default_policies(task, epsilon, own=agent)
    if opponent in SCRIPTED:
        elsewhere = set(task.seat_roles) - {agent.split("_")[0]}
        check(
            bool(elsewhere),
            f"opponent={opponent!r}, but task {task.name!r} has nobody of another role; leave it "
            "out",
        )
        for other in elsewhere:
            rest: Any = (epsilon, task.move_order)
            policies[other] = scripted_policy(str(opponent), other, *rest)
    elif opponent is not None:
        policy: Any = load_opponent(Path(opponent))
        role, seat = role_of(policy), task.seat(agent)
        others = [r for s, r in enumerate(task.seat_roles) if s != seat]
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
    check(
        set(task.mazes) <= set(own.mazes),
        f"{name}: learned in maze {own.mazes[0].name}, and the games are in {task.mazes[0].name}",
    )
    for what in ("num_chasers", "num_evaders", "num_goals", "stay_action", "move_order"):
        mine, theirs = getattr(own, what), getattr(task, what)
        check(mine == theirs, f"{name}: learned with {what}={mine}; the games have {theirs}")
