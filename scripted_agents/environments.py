"""The registered Gymnasium environments, with scripted opponents by default."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gymnasium.vector import AutoresetMode

from pursuit.environments.parallel import RENDER_FPS
from pursuit.environments.single_agent import SingleAgentEnv, SingleAgentVectorEnv
from pursuit.plugins import from_train
from pursuit.rendering.windows import metadata_of
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import ROLES, Task, make_task
from pursuit.validation import one_of, unknown
from scripted_agents.agents.gathering import GatheringTeam
from scripted_agents.agents.runner import NearestGoalRunner
from scripted_agents.agents.scripted import AStarChaser, AStarEvader, RandomAgent, Scripted
from scripted_agents.agents.searchers import (
    SearchingChaser,
    SearchingRunner,
    SweepingChaser,
    WaryEvader,
)
from scripted_agents.agents.uniform import UniformAgent
from scripted_agents.exact.duel.best_response import MoveOrder
from scripted_agents.exact.hidden.beliefs import BeliefChaser
from scripted_agents.exact.joint.optimal import OptimalChaser, OptimalEvader
from scripted_agents.exact.tours.runner import TourRunner
from scripted_agents.games.encoding import mended
from scripted_agents.names import (
    AGENTS,
    POLICIES,
    UNIFORM,
    agent_name,
    check_agent,
    check_plays,
    custom_roles,
    is_agent,
)

DEFAULTS: dict[str, type[Scripted]] = {
    "chaser": AStarChaser,
    "evader": AStarEvader,
    "runner": NearestGoalRunner,
}
"""The default scripted agent of each role."""


MAKERS: dict[str, dict[str, Callable[..., Policy]]] = {
    "searching": {"chaser": SearchingChaser, "evader": WaryEvader, "runner": SearchingRunner},
    "sweeping": {"chaser": SweepingChaser},
    "belief": {"chaser": BeliefChaser},
    "gathering": {"chaser": GatheringTeam},
}
"""The classes of `PLAYED_ROLES`, by name and role."""


def custom_policy(name: str, task: Task, role: str) -> Policy:
    """A user-defined policy in one role of a task.

    Raises:
        ValueError: an unknown policy, one that does not play this role or raises an exception, or
            no `Policy`.
    """
    make, roles = POLICIES.get(name), custom_roles(name, task)
    if role not in roles:
        raise ValueError(f"policy {name!r} plays {', '.join(roles)}, not {role!r}")
    with mended(f"policy {name!r}(task, role)"):
        policy: Policy = make(task, role)
    if not callable(getattr(policy, "act", None)):
        raise ValueError(f"policy {name!r} returned {policy!r}; return a Policy with act(view)")
    return policy


def scripted_policy(
    name: str,
    role: str,
    epsilon: float = 0.0,
    move_order: MoveOrder = "simultaneous",
    discount: float = 0.95,
) -> Policy:
    """A scripted agent by name, one of AGENTS.

    An astar runner goes to the nearest goal. For "equilibrium" ("optimal" is its former name),
    chasers and evaders play that of the duel, runners a shortest tour. Agents of SEARCHERS have the
    view limits of the task.

    Raises:
        ValueError: an unknown name, a role that it does not play, or epsilon outside [0, 1].
    """
    name = agent_name(name)
    if name not in AGENTS:
        raise ValueError(unknown("agent", name, AGENTS))
    one_of("role", role, ROLES)
    if name in MAKERS:
        check_plays(name, role)
        return MAKERS[name][role](epsilon=epsilon)
    if name == "random":
        return RandomAgent()
    if name == UNIFORM:
        return UniformAgent()
    if name == "astar":
        return DEFAULTS[role](epsilon)
    if role == "runner":
        return TourRunner(epsilon)
    form = OptimalChaser if role == "chaser" else OptimalEvader
    return form(epsilon, discount, move_order)


def named_policy(name: str, task: Task, role: str, epsilon: float = 0.0) -> Policy:
    """A scripted agent or a user-defined policy in one role of a task.

    Raises:
        ValueError: an unknown name, or a policy that does not play this role of this task.
    """
    name = agent_name(name)
    if name not in AGENTS:
        return custom_policy(name, task, role)
    check_agent(name, task, role)
    order: Any = task.move_order
    return scripted_policy(name, role, epsilon, order)


def default_policies(task: Task, epsilon: float = 0.0) -> dict[str, Policy]:
    """The scripted policy of every role of `task`, with this probability of random moves."""
    return {role: DEFAULTS[role](epsilon) for role in dict.fromkeys(task.seat_roles)}


def chosen_policies(
    task: Task, agent: str, opponent: Policy | str | Path | None, epsilon: float
) -> dict[str, Policy]:
    """A policy for every role of `task`; `opponent` in all roles but that of your agent.

    If all agents have one role, as in a race, `opponent` is the policy of all others.

    Args:
        task: the game.
        agent: your agent, by name or role.
        opponent: as in `single_agent_arguments`.
        epsilon: probability of random moves of the scripted agents.

    Raises:
        ValueError: an unknown policy, or one that does not play a role of another agent.
    """
    policies = default_policies(task, epsilon)
    if opponent is None:
        return policies
    if isinstance(opponent, str | Path):
        name = str(opponent)
        if not is_agent(name) and (os.path.isdir(name) or Path(name).suffix in (".onnx", ".zip")):
            saved: dict[str, Policy] = from_train("train.runs.opponents:opponents_of")(
                task, agent, name, epsilon
            )
            return saved
    if task.num_agents == 1:
        raise ValueError(
            f"opponent={opponent!r}, but task {task.name!r} has no other role; leave it out"
        )
    own_role = agent.split("_")[0]
    for role in set(task.seat_roles) - {own_role} or {own_role}:
        policies[role] = (
            named_policy(str(opponent), task, role, epsilon)
            if isinstance(opponent, str | Path)
            else opponent
        )
    return policies


def single_agent_arguments(
    task_name: str,
    agent: str,
    maze: Any = "5x5",
    opponent_epsilon: float = 0.0,
    opponent: Policy | str | Path | None = None,
    **settings: Any,
) -> tuple[Task, str, dict[str, Policy]]:
    """The task, agent and policies of a single-agent environment of the named task.

    Args:
        task_name: "chase", "maze", "race", "heist" or "escape".
        agent: your agent, by name or role.
        maze: as in `pursuit.Task`.
        opponent_epsilon: probability of random moves of the scripted opponents.
        opponent: the policy of all other roles (in a race, of the other runners): a `Policy`, a
            name ("astar", "random", "uniform", "equilibrium", "searching", "sweeping", "belief" or
            "gathering"), "package.module:Name" of a user-defined policy, or the folder of a run.
            None for A* (runners: nearest goal). Teammates play A*, unless the run is one of their
            role.
        **settings: those of `pursuit.Task`.
    """
    task = make_task(task_name, maze=maze, **settings)
    return task, agent, chosen_policies(task, agent, opponent, opponent_epsilon)


def make_env(
    task: str,
    agent: str,
    observation: str = "one_hot",
    render_mode: str | None = None,
    mask_bumps: bool = False,
    mask_in_observation: bool = False,
    observation_dtype: str | None = None,
    **settings: Any,
) -> SingleAgentEnv:
    """Any agent of any named task as a Gymnasium environment, with scripted opponents by default.

    Args:
        task: "chase", "maze", "race", "heist" or "escape".
        agent: your agent, by name or role.
        observation: one of `pursuit.observations.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_bumps: whether infos hold an "action_mask" that forbids moves into walls.
        mask_in_observation: whether observations are {"observation", "action_mask"}.
        observation_dtype: "uint8" for planes, windows and "one_hot", in a quarter of the memory;
            None for the dtype of the encoding.
        **settings: maze, opponent_epsilon (probability of random moves of the scripted opponents, 0
            by default), opponent (of all other roles: a `Policy`, one of AGENTS, the folder of a
            run, or package.module:Name of a user-defined policy), and those of `pursuit.Task`.
    """
    arguments = single_agent_arguments(task, agent, **settings)
    return SingleAgentEnv(
        *arguments, observation, render_mode, mask_bumps, mask_in_observation, observation_dtype
    )


# `gymnasium.make` reads there which render modes need a wrapper of its own.
make_env.metadata = metadata_of(RENDER_FPS)  # type: ignore[attr-defined]


def make_vector_env(
    task: str,
    agent: str,
    num_envs: int = 1,
    observation: str = "one_hot",
    render_mode: str | None = None,
    seed: int | None = None,
    mask_bumps: bool = False,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    mask_in_observation: bool = False,
    max_episode_steps: int | None = None,
    observation_dtype: str | None = None,
    **settings: Any,
) -> SingleAgentVectorEnv:
    """`make_env` for `num_envs` games in lockstep.

    Args:
        max_episode_steps: truncates earlier than the task, as a TimeLimit; -1 for no limit.
    """
    made, own, policies = single_agent_arguments(task, agent, **settings)
    modes = render_mode, seed, mask_bumps, autoreset_mode, mask_in_observation, observation_dtype
    envs = SingleAgentVectorEnv(made, own, policies, num_envs, observation, *modes)
    envs.limit_episodes(max_episode_steps)
    return envs
