"""Small games as the environments use them: spaces, masks, starts, actions, and policies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.interface import GameInterface
from pursuit.environments.types import Actions, Options, Space
from pursuit.rendering.text import TextScene
from pursuit.rules.arrays import Array
from pursuit.simulator.next_episode import game_indices
from pursuit.simulator.simulator import Simulator
from pursuit.validation import as_array, check, one_of, reset_options, shortened
from scripted_agents.games.agents import TableAgent
from scripted_agents.games.named import load_game
from scripted_agents.games.rendering import scene_of
from scripted_agents.games.simulator import (
    ENCODINGS,
    INDEX,
    OBSERVE,
    ONE_HOT,
    GameSimulator,
    GameTask,
    StatePolicy,
)
from scripted_agents.games.small_game import Behaviour, SmallGame
from scripted_agents.games.solve import check_policies

PlayedGame = SmallGame | GameTask | str
"""An enumerated game, with a limit on steps, or the name of one; see `load_game`."""
Opponent = Behaviour | StatePolicy
"""What plays another player: see `SmallGame.table`, or a `TableAgent`."""


def task_of(game: PlayedGame, max_steps: int | None = None) -> GameTask:
    """A game with a time limit: `max_steps`, or else its own, or else that of `GameTask`.

    Raises:
        ValueError: a game that is not enumerated, an unknown name, or `max_steps` below 1.
    """
    if isinstance(game, str):
        task = GameTask(load_game(game), game)
    else:
        task = game if isinstance(game, GameTask) else GameTask(game)
    return task if max_steps is None else replace(task, max_steps=max_steps)


def seat_policies(
    task: GameTask, policies: Mapping[str, Opponent], player: int
) -> list[StatePolicy | None]:
    """The policy of every player but one, which has None.

    Raises:
        ValueError: a policy that is missing or no distribution, or one of an unknown player.
    """
    others = [name for seat, name in enumerate(task.agent_names) if seat != player]
    check_policies(task.game, policies, others)
    filled: list[StatePolicy | None] = [None] * task.num_agents
    for name in others:
        given: Any = policies[name]
        filled[task.seat(name)] = given if hasattr(given, "act") else TableAgent(task, name, given)
    return filled


class SmallGameInterface(GameInterface):
    """A batch of copies of a small game.

    Args:
        simulator: a simulator with `auto_restart=False`.
        observation: one of `simulator.ENCODINGS`.
        recorded: of one game of a task, a simulator of the task that plays the same episodes.

    Raises:
        ValueError: an unknown observation.
    """

    simulator: GameSimulator

    def __init__(
        self, simulator: GameSimulator, observation: str, recorded: Simulator | None = None
    ) -> None:
        super().__init__(simulator)
        self.task, self.recorded = simulator.task, recorded
        self.observation = one_of("observation", observation, ENCODINGS)
        self._legal = [self.task.legal(seat) for seat in self.seats.values()]

    def observation_space(self, seat: int) -> Space:
        """That of the encoding."""
        states = self.task.game.num_states
        if self.observation == OBSERVE:
            shape = self.task.observations(seat, OBSERVE).shape[1:]
            return Box(-np.inf, np.inf, shape, np.float32)
        if self.observation == INDEX:
            return Box(0, states - 1, (1,), np.int32)
        return Box(0.0, 1.0, (states,), np.float32)

    def action_space(self, seat: int) -> Space:
        """The numbers of `game.action_lists`."""
        return Discrete(self.task.num_actions(seat))

    def start(self, seed: int | None, options: Options, games: ArrayLike | None = None) -> None:
        """Start new episodes, with the option "state" in this state."""
        given, number = reset_options(options, ("state",)), None
        simulator, game = self.simulator, self.task.game
        if given:
            state = given["state"]
            with suppress(TypeError):  # not hashable
                number = game.number.get(state)
            rule = f"give a state of the game, as in {shortened(game.states[:3])}"
            check(number is not None, f"state={shortened(state)}; {rule}")
        simulator.reset(seed, games)
        if number is not None:
            simulator.state[game_indices(games, simulator.num_games)] = number
        if self.recorded is not None:
            first: Any = game.states[simulator.state[0]]
            exits = first[2] if self.recorded.task.num_exits else None
            self.recorded.place(first[0], first[1] or None, seed=seed, exits=exits)

    def policies_of(self, seat: int, policies: Mapping[str, Opponent]) -> list[StatePolicy | None]:
        """As `seat_policies`."""
        return seat_policies(self.simulator.task, policies, seat)

    def _number(self, seat: int, action: ArrayLike) -> NDArray[np.int32]:
        """[1] the number of an action, legal or not; ValueError for other values."""
        most = self.num_actions[seat] - 1
        rule = f"the actions of {self.agents[seat]} are numbers from 0 to {most}"
        given = as_array("action", action, "iu", rule)
        if given.size != 1 or not 0 <= given.item() <= most:
            raise ValueError(f"action={shortened(action)}; {rule}")
        return self._with_waits(seat, given.reshape(1))

    def _with_waits(self, seat: int, actions: Array) -> NDArray[np.int32]:
        """[games] the actions, with None where the player is not to move, whatever is given."""
        waits = self.task.waiting[seat, self.simulator.state]
        return np.where(waits, self.num_actions[seat] - 1, actions).astype(np.int32)

    def _check_legal(self, seat: int, numbers: Array, over: NDArray[np.bool_]) -> None:
        simulator = self.simulator
        wrong = ~self._legal[seat][simulator.state, numbers] & ~(simulator.ended | over)
        if wrong.any():
            game = int(wrong.argmax())
            why = simulator.why_illegal(game, seat, int(numbers[game]))
            raise ValueError(f"{why}; use action_masks(), as sb3-contrib's MaskablePPO does")

    def check_action(self, seat: int, action: Any) -> Array:
        """[1] the number of a legal action."""
        numbers = self._number(seat, action)
        self._check_legal(seat, numbers, self.simulator.ended)
        return numbers

    def check_actions(self, seat: int, actions: ArrayLike, over: NDArray[np.bool_]) -> Array:
        """[num_games] the numbers of legal actions."""
        numbers = self._with_waits(seat, super().check_actions(seat, actions, over))
        self._check_legal(seat, numbers, over)
        return numbers

    def step(self, seat: int, actions: Any) -> None:
        """As `GameInterface.step`, with the recorded game."""
        super().step(seat, actions)
        if self.recorded is not None:
            pairs = zip(self.task.game.action_lists, self.actions[0].tolist(), strict=True)
            self.recorded.step([[every[number] for every, number in pairs]])

    def step_all(self, actions: Actions, agents: Sequence[str]) -> None:
        """As `GameInterface.step_all`; the simulator refuses illegal actions."""
        for agent in agents:
            seat = self.seats[agent]
            self.actions[:, seat] = self._number(seat, actions[agent])
        self.simulator.step(self.actions)

    def has_masks(self, seat: int) -> bool:
        """Unless all actions are legal in all states."""
        return not self._legal[seat].all()

    def masks(self, seat: int) -> NDArray[np.bool_]:
        """The legal actions."""
        return self._legal[seat][self.simulator.state]

    def observe(self, seat: int) -> Array:
        """The encoding of the states."""
        return self.simulator.observe(self.observation, seat)

    @property
    def state_space(self) -> Space:
        """See `state`."""
        return Box(0.0, 1.0, (self.task.game.num_states,), np.float32)

    def state(self) -> NDArray[np.float32]:
        """[states] float32, with a 1 at the number of the state."""
        return self.simulator.observe(ONE_HOT)[0]

    def scene(self, game: int) -> TextScene:
        """The text of the state."""
        return scene_of(self.simulator, game)
