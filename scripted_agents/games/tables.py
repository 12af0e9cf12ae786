"""The transitions of an enumerated game as arrays, and the kernels that step copies of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined
from pursuit.memory import check_memory
from pursuit.rules.arrays import Flags, Ints, Longs, Reals, Words
from pursuit.rules.randomness import next_uniform
from pursuit.validation import check
from scripted_agents.games.small_game import DRAWN, ENDED, SmallGame

STARTS_STREAM, CHANCE_STREAM, FIRST_PLAYER_STREAM = 0, 1, 2
"""The random streams of a game: of start states, of chance, and of each player's policy."""
OK = -1
UNCHANGED = -1.0
"""In place of the probability of random actions from the next episode on."""

Floats = NDArray[np.float32]


class StepTables(NamedTuple):
    """The transitions of a game.

    Attributes:
        begins: [states + 1] int64, the first joint action of each state.
        places: [players, states, actions] int16, the place of an action, by its number in
            `SmallGame.action_lists`, among the legal ones of a state; -1 for illegal ones.
        sizes: [states, players] int16, the number of legal actions.
        after: [joint actions] int32, the next state, `ENDED`, or `DRAWN`.
        rewards: [joint actions, players] float32.
        indptr, states, sums: the rows of `SmallGame.following` as indices and cumulative
            probabilities.
        starts, start_sums: the start states, and their cumulative probabilities.
    """

    begins: Longs
    places: NDArray[np.int16]
    sizes: NDArray[np.int16]
    after: Ints
    rewards: Floats
    indptr: Longs
    states: Ints
    sums: Reals
    starts: Ints
    start_sums: Reals


class Copies(NamedTuple):
    """The arrays of copies of a game; see the attributes of `GameSimulator`."""

    streams: Words
    state: Ints
    steps: Ints
    rewards: Floats
    returns: Reals
    terminated: Flags
    truncated: Flags
    episode_returns: Reals
    episode_lengths: Ints
    final_state: Ints
    epsilon: Reals
    next_epsilon: Reals


def step_tables(game: SmallGame) -> StepTables:
    """The tables of a game; ValueError if they do not fit into memory."""
    players, most = len(game.players), max(map(len, game.action_lists))
    cells = players * game.num_states * most
    needed = 2 * cells + (4 * players + 4) * len(game.choices) + 12 * game.following.nnz
    check_memory(f"stepping a game of {game.num_states:,} states", needed, "give a smaller game")
    check(most < 2**15, f"a player has {most:,} different actions; give a game with fewer")
    largest = float(np.abs(game.rewards).max())
    check(
        largest <= float(np.finfo(np.float32).max),
        f"a reward of {largest:g} does not fit into float32; give smaller rewards",
    )
    places = np.full((players, game.num_states, most), -1, dtype=np.int16)
    for player, (rows, every) in enumerate(zip(game.actions, game.action_lists, strict=True)):
        number = {action: place for place, action in enumerate(every)}
        numbers: dict[int, NDArray[np.intp]] = {}  # equal rows of actions are one object
        for state, row in enumerate(rows):
            if id(row) not in numbers:
                numbers[id(row)] = np.array([number[action] for action in row])
            places[player, state, numbers[id(row)]] = np.arange(len(row))
    csr = game.following
    counts = np.diff(csr.indptr)
    sums = row_sums(csr.data, csr.indptr)
    # The ends of rows without an end of the game are exactly 1, so that no draw is above them.
    last = csr.indptr[1:][counts > 0] - 1
    sums[last[sums[last] >= 1.0 - 1e-9]] = 1.0
    starts = np.flatnonzero(game.start > 0.0)
    start_sums = np.cumsum(game.start[starts])
    start_sums[-1] = 1.0
    return StepTables(
        game.begins.astype(np.int64),
        places,
        np.array([[len(row) for row in rows] for rows in game.actions], dtype=np.int16).T.copy(),
        game.after,
        game.rewards.astype(np.float32),
        csr.indptr.astype(np.int64),
        csr.indices.astype(np.int32),
        sums,
        starts.astype(np.int32),
        start_sums,
    )


def row_sums(chances: Reals, begins: NDArray[Any]) -> Reals:
    """Cumulative sums within each row; `begins` [rows + 1] is where the rows begin.

    Each row by itself: differences of sums over all rows would lose digits.
    """
    sums, counts = chances.copy(), np.diff(begins)
    for place in range(1, int(counts.max(initial=0))):
        here = begins[:-1][counts > place] + place
        sums[here] += sums[here - 1]
    return sums


@inlined
def place_of(sums: Reals, first: int, last: int, draw: float) -> int:
    """The first place in sums[first:last], which ascend, with a sum above `draw`; `last` if there
    is none."""
    while first < last:
        middle = (first + last) >> 1
        if sums[middle] > draw:
            last = middle
        else:
            first = middle + 1
    return first


@inlined
def named(arrays: Any) -> tuple[StepTables, Copies]:
    """The flat arguments of a kernel by name: the fields of `StepTables` and of `Copies`."""
    return StepTables(*arrays[:10]), Copies(*arrays[10:])


@compiled
def start_games(chosen: Flags, *arrays: Any) -> None:
    """Start new episodes in the games of a mask; `arrays` as in `named`."""
    tables, copies = named(arrays)
    for game in range(chosen.shape[0]):
        if chosen[game]:
            _start(game, tables, copies)
            copies.terminated[game] = copies.truncated[game] = False


@inlined
def _start(game: int, tables: StepTables, copies: Copies) -> None:
    draw = next_uniform(copies.streams[game], STARTS_STREAM)
    last = tables.starts.shape[0] - 1
    copies.state[game] = tables.starts[place_of(tables.start_sums, 0, last, draw)]
    copies.steps[game] = 0
    for player in range(copies.returns.shape[1]):
        copies.returns[game, player] = 0.0
        if copies.next_epsilon[game, player] != UNCHANGED:
            copies.epsilon[game, player] = copies.next_epsilon[game, player]
            copies.next_epsilon[game, player] = UNCHANGED


@compiled
def step_games(joints: Longs, actions: Ints, most: int, restart: bool, *arrays: Any) -> int:
    """Step all games, each at most `most` steps; `OK`, or game * players + player of an illegal
    action, and nothing moves.

    Without `restart` games that have ended do not move, and have rewards of 0. `joints` [games] is
    working memory; `arrays` as in `named`.
    """
    tables, copies = named(arrays)
    state, steps, terminated, truncated = (
        copies.state, copies.steps, copies.terminated, copies.truncated
    )  # fmt: skip
    players = actions.shape[1]
    for game in range(actions.shape[0]):
        joint = np.int64(0)
        for player in range(players):
            action = actions[game, player]
            place = -1
            if 0 <= action < tables.places.shape[2]:
                place = np.int64(tables.places[player, state[game], action])
            # With `restart` a game with these flags has already restarted.
            if place < 0 and (restart or not (terminated[game] or truncated[game])):
                return game * players + player
            joint = joint * tables.sizes[state[game], player] + place
        joints[game] = tables.begins[state[game]] + joint
    for game in range(actions.shape[0]):
        if not restart and (terminated[game] or truncated[game]):
            copies.rewards[game, :] = 0.0
            continue
        joint = joints[game]
        following = tables.after[joint]
        if following == DRAWN:
            last = tables.indptr[joint + 1]
            draw = next_uniform(copies.streams[game], CHANCE_STREAM)
            place = place_of(tables.sums, tables.indptr[joint], last, draw)
            following = tables.states[place] if place < last else ENDED
        steps[game] += 1
        for player in range(players):
            copies.rewards[game, player] = tables.rewards[joint, player]
            copies.returns[game, player] += tables.rewards[joint, player]
        terminated[game] = following == ENDED
        truncated[game] = following != ENDED and steps[game] >= most
        if following != ENDED:
            state[game] = following
        if terminated[game] or truncated[game]:
            copies.episode_lengths[game], copies.final_state[game] = steps[game], state[game]
            for player in range(players):
                copies.episode_returns[game, player] = copies.returns[game, player]
            if restart:
                _start(game, tables, copies)
    return OK


class Played(NamedTuple):
    """What happened in some steps of all games; rows [steps, games].

    Attributes:
        state: int32, before the step.
        action: int64, of the first player of the kernel.
        reward: float32, of that player.
        terminated, truncated: bool.
        final: int32, the state after the step; after the end of the game the one before it.
        returns: [steps, games, players] float64, of the episodes that ended in the step.
        lengths: int32, likewise.
        members: int64, likewise: the opponent.
    """

    state: Ints
    action: Longs
    reward: Floats
    terminated: Flags
    truncated: Flags
    final: Ints
    returns: NDArray[np.float64]
    lengths: Ints
    members: Longs


@compiled
def play_steps(
    joints: Longs, actions: Ints, most: int, seats: Longs, draws: Reals, own: Reals, theirs: Reals,
    members: Longs, shares: Reals, played: Played, *arrays: Any,
) -> None:  # fmt: skip
    """Play all games for some steps by tables of two players, with restarts.

    Args:
        joints: [games], working memory.
        actions: [games, 2], working memory.
        most: steps of an episode.
        seats: [2], of the player of `own` and of its opponent.
        draws: [2, steps, games] in [0, 1), for the actions of `own` and for new opponents.
        own: [states, actions], sums of probabilities over the actions by their numbers.
        theirs: [members, states, actions], likewise of every opponent.
        members: [games], the opponent of each game; those of restarted games are drawn anew.
        shares: [members], sums of their probabilities.
        played: written.
        arrays: as in `named`; the games do not restart by themselves.
    """
    tables, copies = named(arrays)
    seat, other = seats[0], seats[1]
    for step in range(draws.shape[1]):
        for game in range(actions.shape[0]):
            state = copies.state[game]
            played.state[step, game] = state
            sums = own[state]
            last = sums.shape[0] - 1
            action = place_of(sums, 0, last, draws[0, step, game] * sums[last])
            played.action[step, game] = action
            actions[game, seat] = action
            sums = theirs[members[game], state]
            last = sums.shape[0] - 1
            draw = next_uniform(copies.streams[game], FIRST_PLAYER_STREAM + other)
            actions[game, other] = place_of(sums, 0, last, draw * sums[last])
        step_games(joints, actions, most, False, *arrays)
        for game in range(actions.shape[0]):
            played.reward[step, game] = copies.rewards[game, seat]
            played.terminated[step, game] = copies.terminated[game]
            played.truncated[step, game] = copies.truncated[game]
            played.final[step, game] = copies.state[game]
            if copies.terminated[game] or copies.truncated[game]:
                for player in range(2):
                    played.returns[step, game, player] = copies.returns[game, player]
                played.lengths[step, game] = copies.steps[game]
                played.members[step, game] = members[game]
                _start(game, tables, copies)
                copies.terminated[game] = copies.truncated[game] = False
                if shares.shape[0] > 1:
                    last = shares.shape[0] - 1
                    draw = draws[1, step, game] * shares[last]
                    members[game] = place_of(shares, 0, last, draw)


@compiled
def draw_actions(
    offsets: Longs, sums: Reals, numbers: Ints, state: Ints, epsilon: Reals, own: float,
    streams: Words, player: int, actions: Ints,
) -> None:  # fmt: skip
    """Draw the actions of a table in every game.

    Args:
        offsets: [states + 1], where the legal actions of each state begin.
        sums: [pairs of a state and an action] cumulative probabilities, from each state's first.
        numbers: [pairs of a state and an action] the numbers of the actions.
        state: [games].
        epsilon: [games, players], the probabilities of a uniformly random action; NaN for `own`.
        own: the probability of the table.
        streams: [games, streams].
        player: whose actions these are.
        actions: [games], written.
    """
    for game in range(state.shape[0]):
        draw = next_uniform(streams[game], FIRST_PLAYER_STREAM + player)
        share = epsilon[game, player]
        if not share >= 0.0:
            share = own
        first, last = offsets[state[game]], offsets[state[game] + 1]
        if draw < share:
            place = first + np.int64(draw / share * (last - first))
        else:
            place = place_of(sums, first, last, (draw - share) / (1.0 - share))
        actions[game] = numbers[min(place, last - 1)]
