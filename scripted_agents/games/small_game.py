"""An enumerated game: its states, its joint actions, and policies as tables over them."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.tasks.task import Task
from pursuit.validation import as_array, check, shortened
from scripted_agents.games.game import Action, State

if TYPE_CHECKING:  # slow to import
    from scipy.sparse import csr_array

ZERO_SUM = 1e-9
"""Sums of rewards up to this share of the largest are 0."""

KEPT = 16
"""Games and their solutions that stay in memory: studies have many runs of several games."""

ENDED, DRAWN = -1, -2
"""In place of the state after a joint action: the game has ended; it is drawn."""

Behaviour = Callable[[State], Mapping[Action, float] | Sequence[float]] | ArrayLike
"""See `SmallGame.table`."""


class ActionLists(tuple[tuple[Hashable, ...], ...]):
    """The actions of each player, by its index or name."""

    players: tuple[str, ...] = ()

    def __getitem__(self, player: Any) -> Any:
        return super().__getitem__(
            index_of(player, self.players) if isinstance(player, str) else player
        )


def index_of(player: str, players: tuple[str, ...]) -> int:
    """The index of a player; ValueError if there is none of this name."""
    check(player in players, f"player {player!r}; the players are {', '.join(players)}")
    return players.index(player)


@dataclass(frozen=True, eq=False)
class SmallGame:
    """All states of a game that can be reached, and their transitions.

    A *joint action* is a choice of every player in one state. They are numbered state after state,
    the last player's action counting fastest.

    Attributes:
        players: the name of each player.
        states: all states; the start states first.
        number: by state, its index in `states`.
        actions: by player and state, the legal actions.
        begins: [states + 1] int64, the first joint action of each state.
        choices: [joint actions, players] int32, the index of each player's action.
        rewards: [joint actions, players] float64, expected rewards of the step.
        following: [joint actions, states] sparse, the probability of each next state; rows add up
            to less than 1 where the game can end.
        start: [states] float64, the probability of starting in each.
        task: the task of a game of `game_of_task`; None for others.
        source: the `Game` that was enumerated, or another object with its optional functions
            `observe` and `draw`; None for others.
    """

    players: tuple[str, ...]
    states: list[Hashable] = field(repr=False)
    number: dict[Hashable, int] = field(repr=False)
    actions: list[list[Sequence[Hashable]]] = field(repr=False)
    begins: NDArray[np.int64] = field(repr=False)
    choices: NDArray[np.int32] = field(repr=False)
    rewards: NDArray[np.float64] = field(repr=False)
    following: csr_array = field(repr=False)
    start: NDArray[np.float64] = field(repr=False)
    task: Task | None = None
    source: object | None = field(default=None, repr=False)

    def __deepcopy__(self, memo: dict[int, object]) -> SmallGame:
        """Itself, as it never changes."""
        return self

    @property
    def num_states(self) -> int:
        """The number of states."""
        return len(self.states)

    def player(self, name: str) -> int:
        """The index of a player; ValueError if there is none of this name."""
        return index_of(name, self.players)

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """[joint actions] int64, the state of each."""
        return np.repeat(np.arange(self.num_states), np.diff(self.begins))

    @cached_property
    def after(self) -> NDArray[np.int32]:
        """[joint actions] int32, the only state that can follow, or `ENDED`, or `DRAWN`."""
        counts, first = np.diff(self.following.indptr), self.following.indptr[:-1]
        after = np.where(counts > 0, DRAWN, ENDED).astype(np.int32)
        single = np.flatnonzero(counts == 1)
        certain = single[self.following.data[first[single]] >= 1.0 - 1e-12]
        after[certain] = self.following.indices[first[certain]]
        return after

    def joint_action(self, state: int, chosen: Sequence[int]) -> int:
        """The number of the joint action with these indices of the players' actions."""
        within = 0
        for actions, index in zip(self.actions, chosen, strict=True):
            within = within * len(actions[state]) + index
        return int(self.begins[state]) + within

    def outcomes(self, joint: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """The states that follow a joint action, and their probabilities."""
        row = slice(*self.following.indptr[joint : joint + 2])
        return self.following.indices[row], self.following.data[row]

    @cached_property
    def action_lists(self) -> ActionLists:
        """By player (index or name) all its different actions: whole numbers sorted, others in
        order of first appearance, None last. The place of an action is its number in the vector
        simulator and in environments."""
        found = []
        for rows in self.actions:
            lists = dict.fromkeys(map(tuple, rows))
            every = [*dict.fromkeys(action for row in lists for action in row)]
            if all(action is None or type(action) is int for action in every):
                every.sort(key=lambda action: (action is None, action))
            elif None in every:
                every.append(every.pop(every.index(None)))
            found.append(tuple(every))
        actions = ActionLists(found)
        actions.players = self.players
        return actions

    @cached_property
    def unbalanced(self) -> NDArray[np.bool_]:
        """[joint actions] bool: whether the rewards do not add up to 0."""
        largest = np.maximum(1.0, np.abs(self.rewards[:, 0]))
        return np.abs(self.rewards.sum(axis=1)) > ZERO_SUM * largest

    @cached_property
    def digest(self) -> str:
        """A hash of the numbers of states and actions: of all transitions, rewards and starts, and
        of the order of actions that are numbers or texts. A policy of another digest would play
        other actions than it learned."""
        every = self.following
        arrays = (self.begins, self.rewards, every.indptr, every.indices, every.data, self.start)
        plain = [
            [action if isinstance(action, int | float | str) else None for action in row]
            for row in self.action_lists
        ]
        found = sha256(repr((self.players, plain)).encode())
        for array in arrays:
            found.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
        return found.hexdigest()

    @property
    def zero_sum(self) -> bool:
        """Whether there are two players with opposite rewards."""
        return len(self.players) == 2 and not self.unbalanced.any()

    @cached_property
    def _offsets(self) -> list[NDArray[np.int64]]:
        return [np.cumsum([0, *map(len, rows)], dtype=np.int64) for rows in self.actions]

    def offsets(self, player: int) -> NDArray[np.int64]:
        """[states + 1] int64: where the actions of each state begin in a table of this player."""
        return self._offsets[player]

    def table(self, player: str, policy: Behaviour) -> NDArray[np.float64]:
        """The probabilities of a policy as a flat array: the legal actions of state after state.

        Args:
            player: its name.
            policy: a function of a state that returns the probability of each action, as a mapping
                or in the order of the legal actions; or such a flat array.

        Raises:
            ValueError: an unknown action, a wrong number of probabilities, or no distribution.
        """
        index = self.player(player)
        offsets = self.offsets(index)
        if not callable(policy):
            rule = "give a function of a state, or an array of probabilities"
            table = as_array(f"the policy of {player}", policy, "biuf", rule).astype(np.float64)
            if table.shape != (offsets[-1],):
                raise ValueError(
                    f"the table of {player} has shape {table.shape}; the game has "
                    f"{offsets[-1]} pairs of a state and an action of this player"
                )
        else:
            table = np.empty(offsets[-1])
            for number, state in enumerate(self.states):
                actions = self.actions[index][number]
                row = _in_order(policy(state), actions, player, state)
                table[offsets[number] : offsets[number + 1]] = row
        total = np.add.reduceat(table, offsets[:-1])
        bad = ~(np.abs(total - 1.0) <= 1e-6) | (np.minimum.reduceat(table, offsets[:-1]) < 0.0)
        if bad.any():
            state = int(np.argmax(bad))
            row = table[offsets[state] : offsets[state + 1]].tolist()
            raise ValueError(
                f"the probabilities of {player} in {shortened(self.states[state])} are {row}; give "
                "non-negative ones with sum 1"
            )
        return table / np.repeat(total, np.diff(offsets))


def _in_order(
    given: Any, actions: Sequence[Hashable], player: str, state: Hashable
) -> NDArray[np.float64]:
    if isinstance(given, Mapping):
        unknown = [action for action in given if action not in actions]
        if unknown:
            raise ValueError(
                f"{player} plays {shortened(unknown[0])} in {shortened(state)}; the actions are "
                f"{shortened(list(actions))}"
            )
        given = [given.get(action, 0.0) for action in actions]
    what = f"the policy of {player} in {shortened(state)}: probabilities"
    rule = f"give {len(actions)} probabilities, one for each of {shortened(list(actions))}"
    row = as_array(what, given, "biuf", rule)
    if row.shape != (len(actions),):
        raise ValueError(f"{what}={shortened(given)}; {rule}")
    return row


def check_game(game: SmallGame) -> None:
    """ValueError unless it is an enumerated game."""
    if not isinstance(game, SmallGame):
        raise ValueError(f"{shortened(game)} is not enumerated; give enumerate_game(game)")


def longest_play(game: SmallGame) -> int | None:
    """The largest number of steps of an episode; None if one can go on forever."""
    from scipy.sparse import csr_array  # slow to import

    check_game(game)
    joints = np.arange(len(game.owners))
    owner = csr_array((np.ones(len(joints)), (game.owners, joints)))
    edges = (owner @ game.following).tocsr()
    edges.eliminate_zeros()
    edges.data[:] = 1.0
    waiting = np.bincount(edges.indices, minlength=game.num_states)  # edges into each state
    layer = np.flatnonzero(waiting == 0)
    length, done = 0, 0
    while len(layer):  # of states whose predecessors are all done (Kahn, 1962)
        length, done = length + 1, done + len(layer)
        reached = edges[layer].indices
        waiting -= np.bincount(reached, minlength=game.num_states)
        candidates = np.unique(reached)
        layer = candidates[waiting[candidates] == 0]
    return length if done == game.num_states else None
