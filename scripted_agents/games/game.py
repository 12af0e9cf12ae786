"""The protocol of a small game, and PettingZoo environments as such games."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from pettingzoo import ParallelEnv

from pursuit.environments.types import Info, Parallel
from pursuit.validation import shortened

State: TypeAlias = Any
"""A hashable object, of which kind is up to the game."""
Action: TypeAlias = Any
"""Likewise."""
Transition = tuple[float, Hashable, Sequence[float], bool]
"""Probability, next state, the reward of each player, and whether the game has ended."""


@runtime_checkable
class Game(Protocol):
    """A game with finitely many states, in which all players choose at once.

    In a game with turns, all players but one have a single action. States and actions can be any
    hashable objects. Equal states must have equal futures.

    A game can also have `draw(state)`: a picture of a state for replays, as text of one or more
    lines, or as SVG that begins with `<svg`.

    Attributes:
        players: the name of each player.
    """

    @property
    def players(self) -> Sequence[str]: ...  # noqa: D102 -- see the class

    def starts(self) -> Iterable[tuple[float, Hashable]]:
        """The probability of each start state."""
        ...

    def legal_actions(self, state: State, player: int) -> Sequence[Hashable]:
        """The actions of a player, by its index, in a state; at least one."""
        ...

    def transitions(self, state: State, actions: tuple[Action, ...]) -> Iterable[Transition]:
        """What can follow when the players choose these actions; probabilities with sum 1."""
        ...


class ParallelGame:
    """A PettingZoo parallel environment as a `Game`.

    Its transitions must be deterministic, apart from `reset`. An agent's actions are all of its
    `Discrete` space, or those of its `action_mask` (in the infos, or in a dict observation).

    Args:
        env: the environment, without a limit on steps.
        save: `save(env)` returns the state as a hashable object, with the agents that are left.
        restore: `restore(env, state)` sets it. After it, `env.agents` must be right.
        seeds: of `reset`: each gives one start state, equally likely.

    Raises:
        ValueError: a space that is not `Discrete`, or no seeds. While it is enumerated: a state
            that is not hashable, a truncation, a step with two different outcomes, or a state that
            `restore` does not set.
    """

    def __init__(
        self,
        env: Parallel,
        save: Callable[[Any], Hashable],
        restore: Callable[[Any, Any], None],
        seeds: Iterable[int] = (0,),
    ) -> None:
        self.env, self._save, self._restore = env, save, restore
        if not isinstance(env, ParallelEnv):
            raise ValueError(f"{env!r}; give a parallel environment of PettingZoo")
        for name, function in (("save", save), ("restore", restore)):
            if not callable(function):
                raise ValueError(f"{name}={function!r}; give a function")
        self.players: tuple[str, ...] = tuple(env.possible_agents)
        self._seeds = tuple(seeds) if isinstance(seeds, Iterable) else ()
        if not self._seeds:
            raise ValueError(f"seeds={seeds!r}; give a list of seeds of reset")
        for agent in self.players:
            if not hasattr(env.action_space(agent), "n"):
                space = env.action_space(agent)
                raise ValueError(f"the actions of {agent} are {space}; give a Discrete space")

    def starts(self) -> list[tuple[float, Hashable]]:
        """The state after `reset` with each of the seeds."""
        share = 1.0 / len(self._seeds)
        return [(share, self._state(*self.env.reset(seed=seed))) for seed in self._seeds]

    def legal_actions(self, state: State, player: int) -> Sequence[int]:
        """The legal actions; of an agent that has left only 0, which is not played."""
        actions: Sequence[int] = state[1][player]
        return actions

    def transitions(self, state: State, actions: tuple[int, ...]) -> list[Transition]:
        """The one outcome of a step, found twice."""
        first, second = self._step(state, actions), self._step(state, actions)
        if first != second:
            raise ValueError(
                f"two steps from {shortened(state[0])} with {actions} led to {shortened(first[1])} "
                f"and {shortened(second[1])}; the environment draws random numbers in a step, or "
                "`save` leaves something out: write it as a Game with probabilities"
            )
        return [first]

    def _step(self, state: State, actions: tuple[int, ...]) -> Transition:
        self._restore(self.env, state[0])
        if not self.env.agents:
            raise ValueError(
                f"after restore(env, {shortened(state[0])}) env.agents is empty; restore must set "
                "it"
            )
        found = self._save(self.env)
        if found != state[0]:
            raise ValueError(
                f"after restore(env, {shortened(state[0])}) save(env) returns {shortened(found)}; "
                "restore must set all that save returns"
            )
        chosen = dict(zip(self.players, actions, strict=True))
        playing = {agent: chosen[agent] for agent in self.env.agents}
        observations, rewards, terminations, truncations, infos = self.env.step(playing)
        if any(truncations.values()) and not all(terminations.values()):
            raise ValueError(
                f"the environment truncates in {shortened(state[0])}; make it without a limit on "
                "steps, and give the solver a horizon"
            )
        ended = not self.env.agents or all(terminations.values())
        given = [float(rewards.get(agent, 0.0)) for agent in self.players]
        return 1.0, self._state(observations, infos), given, ended

    def _state(
        self, observations: Info, infos: dict[str, Info]
    ) -> tuple[Hashable, tuple[tuple[int, ...], ...]]:
        legal = []
        for agent in self.players:
            seen = observations.get(agent) if agent in self.env.agents else None
            mask = infos.get(agent, {}).get("action_mask") if seen is not None else None
            if isinstance(seen, dict):
                mask = seen.get("action_mask", mask)
            every = range(int(self.env.action_space(agent).n)) if seen is not None else (0,)
            legal.append(tuple(every) if mask is None else tuple(np.flatnonzero(mask).tolist()))
        return self._save(self.env), tuple(legal)
