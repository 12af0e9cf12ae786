"""The names of scripted agents and of user-defined policies, and the roles that they play."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from pursuit.plugins import Registry, is_reference
from pursuit.tasks.task import ROLES, Task
from scripted_agents.agents.gathering import check_gathers
from scripted_agents.exact.limits import check_belief, check_optimal

if TYPE_CHECKING:  # slow to import
    from pursuit.simulator.policy import Policy

UNIFORM, EQUILIBRIUM = "uniform", "equilibrium"
"""The name of `UniformAgent`, which is in no table of references, and that of optimal play."""

SCRIPTED_NAMES = ("astar", "random", EQUILIBRIUM)
"""The names on the command line of scripted agents with a full view, which play all roles."""

SEARCHERS = {"searching": ROLES, "sweeping": ("chaser",), "belief": ("chaser",)}
"""The roles of the scripted agents with the view limits of the task, by name."""

PLAYED_ROLES = {**SEARCHERS, "gathering": ("chaser",)}
"""The roles of the scripted agents that do not play all roles, or do so by a class for each."""

AGENTS = (*SCRIPTED_NAMES, UNIFORM, *PLAYED_ROLES)
"""All names of scripted agents."""

GAME_AGENTS = (UNIFORM, EQUILIBRIUM)
"""The names of policies of players of small games; `EQUILIBRIUM` in zero-sum games of two."""

GAME_DISCOUNT = 0.95
"""Of the equilibrium of a small game that can go on forever."""

POLICIES: Registry[Callable[[Task, str], Policy]] = Registry(
    "policy", "a class or function (task, role) -> Policy", callable, plural="policies", ours=AGENTS
)
"""User-defined policies. The attribute `roles` of a class restricts it to these roles."""


def agent_name(name: str) -> str:
    """The present name of a scripted agent; any other name as it is."""
    return EQUILIBRIUM if name == "optimal" else name


def is_custom_policy(name: str) -> bool:
    """Whether a name is that of a user-defined policy."""
    return is_reference(name) or (name not in AGENTS and name in POLICIES.names())


def custom_roles(name: str, task: Task) -> tuple[str, ...]:
    """The roles of a task that a user-defined policy plays; ValueError for an unknown policy."""
    plays = getattr(POLICIES.get(name), "roles", task.seat_roles)
    return tuple(role for role in dict.fromkeys(task.seat_roles) if role in plays)


def roles_of_agent(name: str, task: Task) -> tuple[str, ...]:
    """The roles of a task that a scripted agent or a user-defined policy plays."""
    name = agent_name(name)
    if name not in AGENTS:
        return custom_roles(name, task)
    plays = PLAYED_ROLES.get(name, ROLES)
    return tuple(role for role in ROLES if role in plays and role in task.seat_roles)


def check_plays(name: str, role: str) -> None:
    """ValueError unless a scripted agent plays a role."""
    roles = PLAYED_ROLES.get(name, ROLES)
    if role not in roles:
        raise ValueError(
            f"{name} plays {', '.join(roles)}; {role!r} is needed. Use "
            f"{', '.join(other for other in AGENTS if role in PLAYED_ROLES.get(other, ROLES))}"
        )


def check_agent(name: str, task: Task, role: str) -> None:
    """ValueError, with the reason, unless a scripted agent plays a role of a task."""
    check_plays(name, role)
    if agent_name(name) == EQUILIBRIUM:
        check_optimal(task, role)
    if name == "belief":
        check_belief(task, "belief")
    if name == "gathering":
        check_gathers(task)


def plays(name: str, task: Task, role: str) -> bool:
    """Whether `check_agent` accepts a scripted agent."""
    try:
        check_agent(name, task, role)
    except ValueError:
        return False
    return True


def is_agent(name: str) -> bool:
    """Whether a name is that of a scripted agent or of a user-defined policy."""
    return agent_name(name) in AGENTS or is_custom_policy(name)
