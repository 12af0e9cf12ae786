"""The policies of games in mazes by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import check
from scripted_agents.environments import chosen_policies, default_policies, named_policy
from scripted_agents.names import AGENTS, is_agent, roles_of_agent
from train.families.policies import NamedPolicies, SavedRuns, check_side, loaded_policy
from train.networks.policy import MazeSeat
from train.settings.task import TaskSettings


def opponents_of(
    saved: SavedRuns,
    task: Task,
    agent: str,
    opponent: str | None,
    epsilon: float,
    played: str = "sampled",
    observation: str | None = None,
) -> dict[str, Policy]:
    """The policy of every role: scripted, or `opponent` for its role.

    Args:
        saved: reads saved runs.
        task: the game.
        agent: the learning agent.
        opponent: one of AGENTS, a user-defined policy, the folder of a run (of self-play: its other
            side) or a model's .onnx or .zip; None for A*.
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
    path = Path(opponent)
    if (sides := saved.sides(path)) is not None:
        check_side(opponent, sides, first)
        if (fixed := sides.get(first)) is not None:
            return opponents_of(saved, task, agent, fixed.name, epsilon, fixed.played, observation)
        path /= first
    trained = {"task": task, "agent": first, "observation": observation}
    policy = loaded_policy(MAZE_POLICIES, saved, path, played, **trained)
    role = role_of(policy)
    check(
        role in others,
        f"opponent={opponent!r} is a policy for {role!r}; give one for another agent of task "
        f"{task.name!r}: {', '.join(others) or 'none'}",
    )
    return {**default_policies(task, epsilon), role: policy}


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
    same = ("num_chasers", "num_evaders", "num_goals", "stay_action", "move_order")
    for what in same:
        mine, theirs = getattr(own, what), getattr(task, what)
        check(mine == theirs, f"{name}: was trained with {what}={mine}, not {theirs}; use {mine}")
    check(
        own.most_exits == task.most_exits,
        f"{name}: was trained with {own.most_exits} exits, not {task.most_exits}; use as many: "
        "task escape, exits and num_exits set them",
    )


def placed(policy: Policy, task: Task, agent: str, name: str, epsilon: float) -> Policy:
    """A policy, a learned one checked by `check_fits`; it makes no random moves."""
    if hasattr(policy, "task"):  # scripted ones may be of roles that the task does not have
        check_fits(policy, task.seat_roles[task.seat(agent)], task, name)
    return policy


MODELS = {".onnx": MazeSeat, ".zip": MazeSeat}
MAZE_POLICIES = NamedPolicies(
    TaskSettings, AGENTS, is_agent, named_policy, roles_of_agent, placed, role_of, MODELS
)
