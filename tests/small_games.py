"""Small games for tests: with chance, in turns, of three players, with illegal actions."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from scripted_agents.games import SmallGame, enumerate_game


class Doors:
    """Two rooms with a door; every second step it opens with probability 0.9."""

    players = ("guard", "thief")

    def starts(self) -> Any:
        return [(0.25, ("left", "right", 0)), (0.75, ("left", "left", 0))]

    def legal_actions(self, state: Any, player: int) -> Any:
        return ("wait", "go")

    def transitions(self, state: Any, actions: Any) -> Any:
        guard, thief, clock = state
        other = {"left": "right", "right": "left"}

        def after(is_open: bool) -> Any:
            places = [
                other[place] if is_open and action == "go" else place
                for place, action in zip((guard, thief), actions, strict=True)
            ]
            reward = 1.0 if places[0] == places[1] else -1.0
            return (*places, 1 - clock), (reward, -reward), False

        if clock == 0:
            return [(1.0, *after(False))]
        return [(0.9, *after(True)), (0.1, *after(False))]

    def draw(self, state: Any) -> str:
        return f"guard {state[0]}\nthief {state[1]}"


class Nim:
    """A heap; the players in turn take 1 to `most`, and who takes the last one wins 1."""

    players = ("first", "second")

    def __init__(self, least: int = 5, heap: int = 8, most: int = 3) -> None:
        self.least, self.heap, self.most = least, heap, most

    def starts(self) -> Any:
        heaps = range(self.least, self.heap + 1)
        return [(1 / len(heaps), (heap, 0)) for heap in heaps]

    def legal_actions(self, state: Any, player: int) -> Any:
        heap, mover = state
        return range(1, min(self.most, heap) + 1) if player == mover else (None,)

    def transitions(self, state: Any, actions: Any) -> Any:
        heap, mover = state
        left = heap - actions[mover]
        won = (1.0 - 2.0 * mover) * (left == 0)
        return [(1.0, (left, 1 - mover), (won, -won), left == 0)]

    def observe(self, state: Any, player: int) -> Any:
        return [state[0], state[1] == player]


class RandomGame:
    """Random transitions, and legal actions in random order; rewards are multiples of 1/8.

    Args:
        players, states: how many.
        seed: of everything.
        outcomes: of a joint action; 1 for a game without chance.
        ends: the share of outcomes that end the game.
        all_legal: whether all 3 actions are legal in all states.
    """

    def __init__(
        self,
        players: int = 2,
        states: int = 7,
        seed: int = 0,
        outcomes: int = 3,
        ends: float = 0.2,
        all_legal: bool = False,
    ) -> None:
        self.players = tuple(f"p{player}" for player in range(players))
        random = np.random.default_rng(seed)
        self.names: list[list[list[str]]] = []
        self.table: dict[Any, Any] = {}
        for state in range(states):
            sizes = [3 if all_legal else random.integers(1, 4) for _ in self.players]
            names = [random.permutation(["x", "y", "z"])[:size].tolist() for size in sizes]
            self.names.append(names)
            for actions in product(*names):
                after = random.choice(states, outcomes, replace=False).tolist()
                chances = random.dirichlet(np.ones(outcomes)).tolist()
                rewards = (random.integers(-16, 17, (outcomes, players)) / 8).tolist()
                over = (random.random(outcomes) < ends).tolist()
                self.table[state, actions] = [*zip(chances, after, rewards, over, strict=True)]

    def starts(self) -> Any:
        return [(0.5, 0), (0.3, 1), (0.2, 2)]

    def legal_actions(self, state: Any, player: int) -> Any:
        return self.names[state][player]

    def transitions(self, state: Any, actions: Any) -> Any:
        return self.table[state, actions]


def random_tables(game: SmallGame, seed: int) -> dict[str, Any]:
    """A random policy of every player, as of `SmallGame.table`."""
    random = np.random.default_rng(seed)
    return {
        name: np.concatenate([random.dirichlet(np.ones(len(row))) for row in game.actions[seat]])
        for seat, name in enumerate(game.players)
    }


def legal_actions(game: SmallGame, state: int, seat: int) -> list[int]:
    """The numbers of the legal actions of a player in a state, from the rows of the game."""
    every = game.action_lists[seat]
    return sorted(every.index(action) for action in game.actions[seat][state])


GAMES: dict[str, Any] = {
    "chance": lambda: enumerate_game(Doors()),
    "turns": lambda: enumerate_game(Nim()),
    "three": lambda: enumerate_game(RandomGame(3, all_legal=True)),
    "masks": lambda: enumerate_game(RandomGame(2, seed=3)),
}
"""Games by what is special about them."""


def state_table(state: Any) -> Any:
    """A policy of the second player of `Nim`."""
    heap, mover = state
    return [1.0] if mover == 0 else [1 / min(3, heap)] * min(3, heap)
