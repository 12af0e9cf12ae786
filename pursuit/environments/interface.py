"""`GameInterface`: what the environments must know of a kind of games beside its `Batch`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import cached_property
from operator import index
from typing import Any

import numpy as np
from gymnasium.spaces import Tuple, flatten_space
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.types import Actions, Options, Space
from pursuit.observations.masks import masked_space
from pursuit.rendering.rendering import Drawable
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch
from pursuit.validation import as_array, reset_options


def checked_actions(
    actions: ArrayLike,
    kinds: str,
    shape: tuple[int, ...],
    rule: str,
    limits: tuple[int, int] | None,
) -> Array:
    """`actions` as an array.

    Args:
        actions: the actions of a batch of games.
        kinds: the allowed kinds of dtypes, in NumPy's codes.
        shape: the required shape.
        rule: description of valid actions, for messages.
        limits: the smallest and largest value; None for no check.

    Raises:
        ValueError: a wrong dtype or shape, or a value outside the limits.
    """
    chosen = as_array("actions", actions, kinds, rule)
    if chosen.shape != shape or chosen.dtype.kind not in kinds:
        raise ValueError(
            f"actions of shape {chosen.shape} and dtype {chosen.dtype}; give {rule} of shape "
            f"{shape}"
        )
    if limits is not None:
        low, high = np.minimum.reduce(chosen, axis=None), np.maximum.reduce(chosen, axis=None)
        if low < limits[0] or high > limits[1]:
            raise ValueError(f"actions from {low} to {high}; give {rule}")
    return chosen


class GameInterface(ABC):
    """A batch of games as the environments use it; `seat` is always the index of an agent.

    A kind of games gives the spaces, the observations and the scene. The other methods have
    defaults: a reset without options, `Discrete` actions that are all legal, rewards of each agent,
    agents that stay until the game ends, policies by the name of the agent.

    Args:
        simulator: a batch with `auto_restart=False`, in which games that are over do not move. Its
            rewards are [num_games, agents], or [num_games] if all agents share them.

    Attributes:
        simulator: the batch.
        agents: the names of the agents, in their order.
        seats: the index of each agent by its name.
        actions: [num_games, agents] int32, the argument of `simulator.step`.
        render_fps: pictures per second in a window or a video.
    """

    render_fps = 5

    def __init__(self, simulator: Batch[Any], agents: Sequence[str] | None = None) -> None:
        self.simulator = simulator
        self.agents = list(agents or simulator.task.agent_names)
        self.seats = {name: seat for seat, name in enumerate(self.agents)}
        self.actions: Array = np.zeros((simulator.num_games, len(self.agents)), dtype=np.int32)

    # -- what a kind of games gives ----------------------------------------------------------------

    @abstractmethod
    def observation_space(self, seat: int) -> Space:
        """The space of the observations of an agent, without masks."""

    @abstractmethod
    def action_space(self, seat: int) -> Space:
        """The space of the actions of an agent."""

    @abstractmethod
    def observe(self, seat: int) -> Array:
        """[num_games, ...] what an agent observes, a new array."""

    @abstractmethod
    def scene(self, game: int) -> Drawable:
        """The scene of one game; `pursuit.rendering.text.text_scene` makes one of a text."""

    # -- what it may change: the start -------------------------------------------------------------

    def start(self, seed: int | None, options: Options, games: ArrayLike | None = None) -> None:
        """Start new episodes in all games, or those of the mask `games`.

        Raises:
            ValueError: an invalid seed, or options of `reset` that do not exist or are invalid.
                Nothing is changed then.
        """
        reset_options(options, ())
        self.simulator.reset(seed, games)

    def policies_of(self, seat: int, policies: Mapping[str, Any]) -> list[Any]:
        """The policies of all agents in their order, None for `seat`, as for `Batch.act`.

        Args:
            seat: the agent without a policy.
            policies: by the names of the others.

        Raises:
            ValueError: a missing policy, or one for an unknown agent.
        """
        others = [name for name in self.agents if name != self.agents[seat]]
        if not isinstance(policies, Mapping) or {*policies} != {*others}:
            raise ValueError(f"policies={policies!r}; give a dict, a policy for each of {others}")
        return [policies.get(name) for name in self.agents]

    # -- the actions -------------------------------------------------------------------------------

    @cached_property
    def num_actions(self) -> list[int]:
        """[agents] the number of actions of each; 0 where they are not `Discrete`."""
        return [int(getattr(self.action_space(seat), "n", 0)) for seat in self.seats.values()]

    def check_action(self, seat: int, action: Any) -> Any:
        """The action of an agent in a batch of one game, for `actions`; ValueError if invalid."""
        try:
            number = index(action)
        except TypeError:
            number = -1
        if not 0 <= number < self.num_actions[seat]:
            most = self.num_actions[seat] - 1
            raise ValueError(f"action {action!r} of {self.agents[seat]}; integers from 0 to {most}")
        return number

    def check_actions(self, seat: int, actions: ArrayLike, over: NDArray[np.bool_]) -> Array:
        """[num_games, ...] the actions of an agent, for `actions`; ValueError if invalid.

        Args:
            seat: the agent.
            actions: as the user gives them.
            over: [num_games] bool, games where the agent's episode is over: its action is ignored.
        """
        most = self.num_actions[seat] - 1
        rule = f"integers from 0 to {most}"
        return checked_actions(actions, "iu", (self.simulator.num_games,), rule, (0, most))

    def step(self, seat: int, actions: Any) -> None:
        """Step with the checked actions of an agent, and those of policies in `actions`."""
        self.actions[:, seat] = actions
        self.simulator.step(self.actions)

    def step_all(self, actions: Actions, agents: Sequence[str]) -> None:
        """Step a batch of one game with the actions of `agents`, which are all that are active.

        Raises:
            ValueError: an invalid action. Then no agent has moved.
        """
        for agent in agents:
            seat = self.seats[agent]
            self.actions[0, seat] = self.check_action(seat, actions[agent])
        self.simulator.step(self.actions)

    @property
    def active(self) -> Array | None:
        """[num_games, agents] 0 for agents that have left their game; None if none ever does."""
        return None

    # -- the masks ---------------------------------------------------------------------------------

    def has_masks(self, seat: int) -> bool:
        """Whether the infos of an agent hold its mask: not all its actions are always legal."""
        return False

    def masks(self, seat: int) -> NDArray[np.bool_]:
        """[num_games, actions] the legal actions of an agent, a new array.

        Raises:
            ValueError: actions that are not `Discrete`.
        """
        if not self.num_actions[seat]:
            raise ValueError(f"{self.agents[seat]} has no action masks: every action is legal")
        return np.ones((self.simulator.num_games, self.num_actions[seat]), dtype=bool)

    # -- all agents of a batch of one game ---------------------------------------------------------

    def observe_all(self) -> Sequence[Array] | Array:
        """[agents] what each observes in the first game, new arrays."""
        return [self.observe(seat)[0] for seat in self.seats.values()]

    def all_masks(self) -> Sequence[NDArray[np.int8]] | NDArray[np.int8]:
        """[agents] the mask of each in the first game, new arrays."""
        return [self.masks(seat)[0].astype(np.int8) for seat in self.seats.values()]

    @property
    def state_space(self) -> Space:
        """The space of `state`."""
        return flatten_space(Tuple(map(self.observation_space, self.seats.values())))

    def state(self) -> Array:
        """The state of the first game for central critics: the observations of all agents."""
        return np.concatenate([np.ravel(seen) for seen in self.observe_all()])

    # -- for the environments ----------------------------------------------------------------------

    def spaces(self, seat: int, mask_in_observation: bool) -> tuple[Space, Space]:
        """The spaces of observations and actions of an agent, new: they hold random states."""
        seen, actions = deepcopy(self.observation_space(seat)), deepcopy(self.action_space(seat))
        return masked_space(seen, self.num_actions[seat]) if mask_in_observation else seen, actions
