"""Policies by name: scripted agents, saved runs, models of other libraries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import truth
from scripted_agents.environments import (
    chosen_policies,
    default_policies,
    is_agent,
    named_policy,
)
from train.algorithms.registry import entry
from train.runs.folder import (
    CONFIG,
    MISFITS,
    SELF_PLAY,
    check_learned,
    load_checkpoint,
    load_config,
    misfit,
)
from train.runs.saved import load_settings, player_of
from train.runs.stable_baselines import load_stable_baselines
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
        check_learned(algorithm.name, state["trainee"])
        return algorithm.load(settings.hyper, seat, state["trainee"]["learner"], greedy)
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
    if opponent is None or is_agent(opponent):
        return chosen_policies(task, agent, opponent, epsilon)
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
    return {**default_policies(task, epsilon, own=agent), role: policy}


def policy_in_seat(
    name: str,
    task: Task,
    role: str,
    epsilon: float = 0.0,
    played: str = "sampled",
    observation: str | None = None,
) -> Policy:
    """The policy of this name in a role of a task.

    Args:
        name: of a scripted agent, a user's own policy, the folder of a run (of self-play: of both
            sides) or a model's .zip.
        task, role: the games, and whose policy is asked for.
        epsilon: share of random moves of a scripted agent.
        played, observation: as of `opponents_of`.

    Raises:
        ValueError: no policy of this name, or one of another role or of other games.
    """
    if is_agent(name):
        return named_policy(name, task, role, epsilon)
    folder = Path(name)
    path = folder / role if is_self_play(folder) else folder
    policy = load_opponent(path, played, task=task, agent=role, observation=observation)
    check_fits(policy, role, task, name)
    return policy


def is_self_play(folder: Path) -> bool:
    """Whether a folder holds both sides of self-play."""
    return (folder / CONFIG).exists() and load_config(folder)[0] == SELF_PLAY


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
