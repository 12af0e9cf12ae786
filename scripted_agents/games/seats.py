"""What all environments of small games share: spaces, masks, starts, actions, and policies."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.types import Options, Space
from pursuit.observations.masks import masked_space
from pursuit.validation import as_array, check, reset_options, shortened
from scripted_agents.games.agents import TableAgent
from scripted_agents.games.named import load_game
from scripted_agents.games.simulator import INDEX, OBSERVE, GameSimulator, GameTask, StatePolicy
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


def spaces_of(
    task: GameTask, seat: int, observation: str, mask_in_observation: bool
) -> tuple[Space, Space]:
    """The spaces of the observations and the actions of a player.

    Args:
        task: the game.
        seat: the index of the player.
        observation: one of `simulator.ENCODINGS`.
        mask_in_observation: whether observations are {"observation", "action_mask"}.
    """
    states, actions = task.game.num_states, task.num_actions(seat)
    observed: Space
    if observation == OBSERVE:
        shape = task.observations(seat, observation).shape[1:]
        observed = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
    elif observation == INDEX:
        observed = gymnasium.spaces.Box(0, states - 1, (1,), np.int32)
    else:
        observed = gymnasium.spaces.Box(0.0, 1.0, (states,), np.float32)
    if mask_in_observation:
        observed = masked_space(observed, actions)
    return observed, gymnasium.spaces.Discrete(actions)


def begin(
    simulator: GameSimulator,
    seed: int | None,
    options: Options,
    games: NDArray[np.bool_] | None = None,
) -> None:
    """Start new episodes, with the option "state" in this state; ValueError for others."""
    given, number = reset_options(options, ("state",)), None
    if given:
        game, state = simulator.task.game, given["state"]
        with suppress(TypeError):  # not hashable
            number = game.number.get(state)
        rule = f"give a state of the game, as in {shortened(game.states[:3])}"
        check(number is not None, f"state={shortened(state)}; {rule}")
    simulator.reset(seed, games)
    if number is not None:
        simulator.state[slice(None) if games is None else games] = number


def action_number(task: GameTask, seat: int, action: ArrayLike) -> int:
    """The number of an action of a player; ValueError for other values."""
    most = task.num_actions(seat) - 1
    rule = f"the actions of {task.agent_names[seat]} are numbers from 0 to {most}"
    given = as_array("action", action, "iu", rule)
    if given.size != 1 or not 0 <= given.item() <= most:
        raise ValueError(f"action={shortened(action)}; {rule}")
    return int(given.item())


def with_waits(
    simulator: GameSimulator, seat: int, actions: NDArray[np.int32]
) -> NDArray[np.int32]:
    """[games] the actions of a player, with None where it is not to move, whatever is given."""
    waits = simulator.task.waiting[seat, simulator.state]
    return np.where(waits, simulator.task.num_actions(seat) - 1, actions).astype(np.int32)
