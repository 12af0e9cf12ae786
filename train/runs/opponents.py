"""Policies by name: scripted agents, saved runs, and models of other libraries."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pursuit.plugins import reading
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import as_path, check, check_bool, shortened
from scripted_agents.environments import (
    AGENTS,
    chosen_policies,
    default_policies,
    is_agent,
    is_custom_policy,
    named_policy,
)
from scripted_agents.games.agents import AGENTS as GAME_AGENTS
from scripted_agents.games.agents import TableAgent, named_agent
from scripted_agents.games.simulator import GameTask, StatePolicy
from train.algorithms.registry import entry
from train.runs.folder import (
    CONFIG,
    MISFITS,
    SELF_PLAY,
    check_learned,
    load_checkpoint,
    misfit,
    read_config,
)
from train.runs.saved import load_settings, player_of
from train.runs.stable_baselines import load_stable_baselines
from train.settings.task import SmallGameSettings, in_maze
from train.tensors import own_defaults


@own_defaults()
def load_policy(folder: Path | str, greedy: bool = True) -> Any:
    """The policy of a run, from its last checkpoint, on the CPU: a `Policy` of its role.

    Of a small game it is a `StatePolicy`: `policy.table(policy.task)` are its probabilities in all
    states, as `SmallGame.table` and the solvers take them.

    Args:
        folder: of the run; for self-play its `chaser` or `evader`, or a player of the small game.
        greedy: the most probable action; False draws from the learned distribution.

    Raises:
        ValueError: no run, a damaged one, one without a distribution if `greedy` is False; or
            `greedy` is not a bool.
    """
    folder, greedy = as_path("folder", folder), check_bool("greedy", greedy)
    settings, state = load_settings(folder), load_checkpoint(folder)
    algorithm = entry(settings.algorithm)
    check(
        greedy or algorithm.learns_distribution,
        f"{folder}: {settings.algorithm} learns no distribution over actions; use greedy=True",
    )
    with reading(folder / CONFIG):
        seat = player_of(settings)
        try:
            check_learned(algorithm.name, state["trainee"], seat)
            return algorithm.load(settings.hyper, seat, state["trainee"]["learner"], greedy)
        except MISFITS as error:
            raise misfit(folder, error) from None


def load_opponent(path: Path | str, played: str = "sampled", **trained: Any) -> Policy:
    """A policy from the folder of a run, or from a saved Stable-Baselines3 model.

    Args:
        path: of the folder or the .zip file.
        played: "sampled" from the learned distribution, if there is one; or "greedy".
        **trained: task, agent and observation of a model without a description file, as in
            `load_stable_baselines`.

    Raises:
        ValueError: neither of them, or damaged.
    """
    path = Path(path)
    if os.path.isdir(path):  # unlike Path.is_dir() also for names that are too long
        settings = load_settings(path)
        in_maze(settings.task, str(path))
        greedy = played == "greedy" or not entry(settings.algorithm).learns_distribution
        policy = load_policy(path, greedy)
        policy.name = played_name(path, greedy)
        return policy
    check(
        path.suffix == ".zip",
        f"{shortened(str(path))}: not a policy; give one of {', '.join(AGENTS)} (or learn, in "
        "self-play), package.module:Name, a run folder, or a saved Stable-Baselines3 model (.zip)",
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
    """The policy of every role: scripted, or `opponent` for its role.

    Args:
        task: the game.
        agent: the learning agent.
        opponent: one of AGENTS, a user-defined policy, the folder of a run or a model's .zip; None
            for A*.
        epsilon: share of random moves of the scripted agents.
        played: policy of a learned opponent, "sampled" or "greedy".
        observation: of a model without a description file.

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
        f"opponent={opponent!r} is a policy for {role!r}; give one for another agent of task "
        f"{task.name!r}: {', '.join(others) or 'none'}",
    )
    return {**default_policies(task, epsilon), role: policy}


def player_policy(
    name: str, task: GameTask, player: str, epsilon: float = 0.0, greedy: bool = False
) -> StatePolicy:
    """The policy of this name for a player of a small game, as a table.

    Args:
        name: as of `named_agent`; or the folder of a run (of self-play: of all players, also of
            those with a fixed policy).
        task, player: the game, and the player by name.
        epsilon: the probability of a uniformly random action.
        greedy: whether a learned policy plays its most probable action.

    Raises:
        ValueError: an unknown policy, or one of another game or player.
    """
    if name in GAME_AGENTS or is_custom_policy(name):
        return named_agent(name, task, player, epsilon)
    folder = Path(name)
    check(
        os.path.isdir(folder),
        f"{shortened(name)}: not a policy; give {', '.join(GAME_AGENTS)}, package.module:Name of a "
        "function of a state, or a run folder",
    )
    path = folder
    if is_self_play(folder):
        path, (_, plain) = folder / player, read_config(folder)
        sides = plain.get("players")
        check(
            isinstance(sides, Mapping) and player in sides,
            f"{name}: a run of self-play without a player {player}; give a run of this game",
        )
        if isinstance(fixed := plain["players"][player], str):
            epsilon = epsilon or plain["task"].get("opponent_epsilon", 0.0)
            greedy = greedy or plain["task"].get("opponent_policy") == "greedy"
            with reading(folder / CONFIG):
                return player_policy(fixed, task, player, epsilon, greedy)
    settings = load_settings(path)
    check(
        isinstance(settings.task, SmallGameSettings),
        f"{name}: a run of task {settings.task.task!r}; give a run of this game",
    )
    greedy = greedy or not entry(settings.algorithm).learns_distribution
    learned = load_policy(path, greedy)
    check(
        learned.agent == player,
        f"{name}: is a policy of {learned.agent}, not of {player}; give another",
    )
    return TableAgent(task, player, learned.table(task), epsilon, played_name(path, greedy))


def played_name(path: Path, greedy: bool) -> str:
    """The name of a learned policy in tables and results."""
    return f"{path} ({'greedy' if greedy else 'sampled'})"


def policy_in_seat(
    name: str,
    task: Task,
    role: str,
    epsilon: float = 0.0,
    played: str = "sampled",
    observation: str | None = None,
) -> Policy:
    """The policy of this name for a role of a task.

    Args:
        name: of a scripted agent, a user-defined policy, the folder of a run (for self-play: of
            both roles) or a model's .zip.
        task, role: the game, and the role of the policy.
        epsilon: share of random moves of a scripted agent.
        played, observation: as in `opponents_of`.

    Raises:
        ValueError: no policy of this name, or one for another role or other games.
    """
    if is_agent(name):
        return named_policy(name, task, role, epsilon)
    folder = Path(name)
    path = folder / role if is_self_play(folder) else folder
    policy = load_opponent(path, played, task=task, agent=role, observation=observation)
    check_fits(policy, role, task, name)
    return policy


def is_self_play(folder: Path) -> bool:
    """Whether a folder contains a run of self-play."""
    return os.path.exists(folder / CONFIG) and read_config(folder)[0] == SELF_PLAY


def role_of(policy: Any) -> str:
    """The role of a learned policy."""
    task: Task = policy.task
    return task.seat_roles[task.seat(policy.agent)]


def check_fits(policy: Policy, role: str, task: Task, name: str) -> None:
    """ValueError unless a learned policy is for this role and task."""
    if not hasattr(policy, "task"):
        return
    own: Task = policy.task
    learned = role_of(policy)
    check(learned == role, f"{name}: is a policy for {learned!r}, not for {role!r}; give another")
    plays_in = getattr(policy, "plays_in", lambda maze: False)
    check(
        set(task.mazes) <= set(own.mazes) or all(plays_in(maze) for maze in task.mazes),
        f"{name}: was trained in maze {own.mazes[0].name}, not in {task.mazes[0].name}; use that "
        "maze, or train with observation window:R (on graphs, an observation of your own)",
    )
    same = ("num_chasers", "num_evaders", "num_goals", "stay_action", "move_order", "most_exits")
    for what in same:
        mine, theirs = getattr(own, what), getattr(task, what)
        check(mine == theirs, f"{name}: was trained with {what}={mine}, not {theirs}; use {mine}")
