"""`Seat`: a place in a game that learns, with its observations, its actions and its policies."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.arrays import Array
from pursuit.simulator.policy import tells_its_play
from pursuit.validation import Missing, Plain, check, shortened
from train.networks.distributions import are_probabilities
from train.networks.features import Features
from train.networks.numbering import SeatNumbering


class Seat(ABC):
    """An agent of a task, or all agents of a role. Subclasses are frozen dataclasses.

    What is defined here is that of a single agent with discrete actions, without masks.

    Attributes:
        task: of the games.
        agent: name or role.
        encoding: its observation.
        frame_stack: number of stacked observations.
        team: whether all agents of the role learn together; then `agent` is the role.
        joint: whether the agents of the role are one player, with joint actions.
        critic: the observation of a central critic; "" for none.
        continuous: whether actions are continuous: numbers in [-1, 1].
        NO_MEMORY: the kind of game, and why its policies have no memory; "" where they can have it.
        NO_NUMBERS: why its states have no numbers for tables; "" where they have.
        NO_JOINT: the kind of game, if a team cannot be one player in it; "" where it can.
        NO_TEAM: whether it is always a single agent, so that there are no teams.
    """

    task: Any
    agent: str
    encoding: str
    frame_stack: int = 1
    team: bool = False
    joint: bool = False
    critic: str = ""
    continuous: bool = False
    NO_MEMORY: ClassVar[str] = ""
    NO_NUMBERS: ClassVar[str] = "the states of this game have no numbers"
    NO_JOINT: ClassVar[str] = ""
    NO_TEAM: ClassVar[bool] = True

    @property
    def number(self) -> int:
        """The agent index; for a role that of its first agent."""
        return int(self.task.seat(self.agent))

    @property
    def role(self) -> str:
        """The role of the agent; its name where agents have no roles."""
        return str(self.task.seat_roles[self.number])

    @property
    def team_size(self) -> int:
        """The number of agents with its role, including itself."""
        return int(self.task.seat_roles.count(self.role))

    @property
    def members(self) -> int:
        """The number of players of its role: its agents, or the team as one player."""
        return 1 if self.joint else self.team_size

    @property
    @abstractmethod
    def num_actions(self) -> int:
        """The number of discrete actions, or the dimensions of a continuous action."""

    @property
    @abstractmethod
    def features(self) -> Features:
        """The features of the network's input."""

    @property
    def described(self) -> Plain:
        """The task as plain values, for other programs."""
        task = self.task
        return {"task": task.name, "max_steps": task.max_steps, "agents": task.agent_names}

    @property
    def action_names(self) -> list[str]:
        """The names of the discrete actions, for other programs."""
        return [str(number) for number in range(self.num_actions)]

    def in_task(self, described: Plain) -> Seat:
        """This seat in the task that an exported policy describes; ValueError for another game."""
        own = json.loads(json.dumps({**self.described, "max_steps": described.get("max_steps")}))
        check(own == described, f"was exported from another game than {own}; give it there")
        return self

    @property
    def numbering(self) -> SeatNumbering | Missing:
        """The states by number, for tables of action values; ValueError if there are too many."""
        return Missing(self.NO_NUMBERS)

    @property
    def critic_features(self) -> Features | None:
        """The features of the central critic's observation; None without one."""
        return None

    def critic_bounds(self, batch: Any) -> tuple[Array, Array]:
        """As `bounds`, of the central critic's observation; asked only of teams with one."""
        raise AssertionError("no central critic")

    def critic_observations(self, batch: Any) -> Array:
        """[games, members, *shape]: the central critic's observations; asked as `critic_bounds`."""
        raise AssertionError("no central critic")

    @abstractmethod
    def policy(self, network: Any, greedy: bool = True) -> Any:
        """A policy with this network."""

    @property
    def observed(self) -> Array | None:
        """[states, *shape]: the observation in every state of an enumerated game; else None."""
        return None

    # -- in a batch of games ---------------------------------------------------------------------

    @abstractmethod
    def bounds(self, batch: Any) -> tuple[Array, Array]:
        """The least and the largest observation [*shape], unstacked, in their dtype."""

    @abstractmethod
    def observe(self, batch: Any, agents: slice) -> Array:
        """[games, agents, *shape]: the observations of these agents, unstacked; a new array."""

    @property
    def has_masks(self) -> bool:
        """Whether actions can be masked."""
        return False

    def allowed(self, batch: Any, agents: slice) -> NDArray[np.bool_]:
        """[games, agents, actions]: the action masks of these agents."""
        agents_of_seat = len(range(batch.task.num_agents)[agents])
        return np.ones((batch.num_games, agents_of_seat, self.num_actions), dtype=bool)

    def left(self, batch: Any, agents: slice) -> NDArray[np.bool_] | None:
        """[games, agents]: which of these agents have left a game that can go on; None for none."""
        return None

    def probabilities_of(self, policy: Any, batch: Any, agents: slice) -> NDArray[np.float64]:
        """[games, agents, actions]: what a policy plays for these agents in the current states; 1
        for its action where it tells no distribution.

        Raises:
            ValueError: it tells or plays something else than the actions of this seat.
        """
        found = []
        for agent in range(batch.task.num_agents)[agents]:
            if tells_its_play(policy, "distribution"):
                rows = policy.distribution(batch.task, batch.games, agent)
            else:
                chosen = np.asarray(policy.act(batch.view(agent)))
                known = chosen.dtype.kind in "iu" and ((chosen >= 0) & (chosen < self.num_actions))
                check(bool(np.all(known)), f"{policy!r} played {shortened(chosen)}; {self._only()}")
                rows = np.eye(self.num_actions)[chosen]
            shape = (batch.num_games, self.num_actions)
            fits = np.shape(rows) == shape and are_probabilities(rows)
            check(fits, f"{policy!r} gave no probabilities of shape {shape}; {self._only()}")
            found.append(rows)
        return np.stack(found, axis=1)

    def _only(self) -> str:
        return f"the {self.role} has {self.num_actions} actions: {', '.join(self.action_names)}"

    def moves(self, actions: NDArray[Any]) -> Array:
        """The actions of all agents of the seat as the batch takes them, from those of a learner
        [games * members, ...]."""
        return actions.astype(np.int32)
