"""The enumeration of all states of a small game."""

from __future__ import annotations

import contextlib
import sys
from array import array
from collections.abc import Hashable, Iterable, Mapping, Sequence, Sized
from itertools import islice, product
from math import prod
from time import perf_counter
from typing import Any

import numpy as np

from pursuit.memory import check_memory
from pursuit.validation import check_bool, shortened, whole
from scripted_agents.exact.limits import MAX_SMALL_STATES
from scripted_agents.exact.tolerances import SUM_TOLERANCE
from scripted_agents.games.game import Game, State
from scripted_agents.games.small_game import SmallGame

MOST_REWARD = 1e100
"""Sums of larger rewards could be infinite."""
AT_ONCE = 2**16
"""Entries of a list, or joint actions of a state, between two checks of memory."""
SMALLER = "give a smaller game"
MANY, LONG = 200, 20.0
"""Joint actions of a state, and seconds, from which a smaller game is advised."""

FORMS = {
    "starts": (2, "(probability, state)"),
    "legal_actions": (None, "hashable actions, at least one (such as None), all different"),
    "transitions": (4, "(probability, next state, rewards, ended)"),
}
"""What the functions of a game return a list of, and the length of each."""
Call = tuple[Any, ...]
"""A call of a function of the game: its name and its arguments."""
START: Call = ("starts",)


def enumerate_game(
    game: Game, most_states: int = MAX_SMALL_STATES, progress: bool | None = None
) -> SmallGame:
    """Find all states that can be reached from the starts of a game, and their transitions.

    Memory is checked while states are found, as their number is not known before. That of all joint
    actions of a state is checked before its transitions are asked for.

    Args:
        game: the game.
        most_states: above this number of states the game is refused.
        progress: whether a line on stderr shows the states and the memory so far; None for
            yes in a terminal.

    Raises:
        ValueError: a game without players or starts; a state that is not hashable; a player without
            an action; probabilities that do not add up to 1; rewards that are not one number of at
            most `MOST_REWARD` for each player; too many states, or too little memory.
    """
    from scipy.sparse import csr_array  # slow to import

    if isinstance(game, type) or not isinstance(game, Game):
        raise ValueError(
            f"{shortened(game)}; give an object with players and the three methods of Game"
        )
    players = names_of_players(game)
    whole("most_states", most_states, 1)
    if progress is not None:
        check_bool("progress", progress)
    found = _Found(most_states, progress)
    starts = _listed(game, START)
    start_chances = _chances(starts, START)
    start_numbers = [found.add(state, START) for _, state in starts]
    actions: list[list[Sequence[Hashable]]] = [[] for _ in players]
    same: dict[Sequence[Hashable], Sequence[Hashable]] = {}  # equal actions are stored once
    begins, choices, rewards = array("q", [0]), array("i"), array("d")
    rows, columns, chances = array("q"), array("q"), array("d")
    # Twice what is stored, as the arrays are copied at the end.
    number, joint_bytes = 0, 16 + 24 * len(players)
    while number < len(found.states):
        state = found.states[number]
        legal = [_legal(game, state, player) for player in range(len(players))]
        many = prod(map(len, legal))
        joints = begins[-1] + many
        if many > AT_ONCE:
            what = f"{many:,} joint actions in {shortened(state)}"
            check_memory(what, joints * joint_bytes, SMALLER)
        for player, options in enumerate(legal):
            actions[player].append(same.setdefault(options, options))
        for joint, chosen in enumerate(product(*map(range, map(len, legal))), begins[-1]):
            played = tuple(options[i] for options, i in zip(legal, chosen, strict=True))
            call = "transitions", state, played
            outcomes = _listed(game, call)
            mean = [0.0] * len(players)
            likely = zip(_chances(outcomes, call), outcomes, strict=True)
            for chance, (_, after, given, ended) in likely:
                for player, reward in enumerate(_rewards(given, players, call)):
                    mean[player] += chance * reward
                if ended is not True and ended is not False and not isinstance(ended, np.bool_):
                    raise ValueError(f"{_name(call)}: ended={ended!r}; give True or False")
                if not ended and chance > 0.0:
                    rows.append(joint)
                    columns.append(found.add(after, call))
                    chances.append(chance)
            choices.extend(chosen)
            rewards.extend(mean)
            if (joint + 1) % AT_ONCE == 0:
                found.show(number, joints * joint_bytes, joint + 1)
        begins.append(joints)
        number += 1
        if number & (number - 1) == 0 or number % 10_000 == 0:
            found.check(number, joints * joint_bytes, len(rows), joints)
    found.end_line()
    joints = begins[-1]
    following = csr_array(  # adds equal entries
        (np.array(chances), (np.array(rows), np.array(columns))), shape=(joints, number)
    )
    start: Any = np.bincount(start_numbers, start_chances, number)
    return SmallGame(
        players,
        found.states,
        found.number,
        actions,
        np.array(begins),
        np.array(choices).reshape(joints, len(players)),
        np.array(rewards).reshape(joints, len(players)),
        following,
        start,
        source=game,
    )


def names_of_players(game: Game | SmallGame) -> tuple[str, ...]:
    """The names of all players; ValueError for none, equal ones, or something else than text."""
    given = game.players
    players = tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else ()
    if not players or len({name for name in players if isinstance(name, str)}) < len(players):
        raise ValueError(f"players={given!r}; give the name of each player, all different")
    return players


class _Found:
    """The states found so far."""

    def __init__(self, most: int, progress: bool | None) -> None:
        self.most = most
        self.shown = sys.stderr.isatty() if progress is None else progress
        self.began, self.advised = perf_counter(), False
        self.reported = self.began
        self.states: list[Hashable] = []
        self.number: dict[Hashable, int] = {}

    def add(self, state: Hashable, call: Call) -> int:
        """The index of a state, which is added if it is new."""
        try:
            known = self.number.setdefault(state, len(self.states))
        except TypeError:
            raise ValueError(
                f"{_name(call)}: the state {shortened(state)} is not hashable; give a tuple, a "
                "string or a number"
            ) from None
        if known == len(self.states):
            self.states.append(state)
            if len(self.states) > self.most:
                raise ValueError(
                    f"more than {self.most:,} states, such as {shortened(state)}; {SMALLER}, or a "
                    "larger most_states"
                )
        return known

    def check(self, done: int, joint_bytes: int, outcomes: int, joints: int) -> None:
        """Show the progress; ValueError if the states found so far do not fit into memory."""
        each = 200 + sys.getsizeof(self.states[-1]) + (joint_bytes + 60 * outcomes) / done
        size = int(each * len(self.states))
        check_memory(f"{len(self.states):,} states found so far", size, SMALLER)
        self.show(done, size, joints)

    def show(self, done: int, size: int, joints: int) -> None:
        """Show the number of states and of bytes so far, every half second; once an advice if it
        takes long."""
        now, live = perf_counter(), sys.stderr.isatty()
        each, seconds = joints / max(done, 1), (now - self.began) * len(self.states) / max(done, 1)
        if self.shown and not self.advised and each >= MANY and seconds > LONG:
            self.advised = True
            print(
                f"about {each:,.0f} joint actions a state, {seconds:,.0f} s for the states found "
                f"so far; stop with Ctrl-C and {SMALLER}, by arguments in parentheses after its "
                "name",
                file=sys.stderr,
            )
        if self.shown and now - self.reported >= (0.5 if live else 10.0):
            self.reported = now
            line = (
                f"{done:,} of {len(self.states):,} states found so far, {size / 1e9:.2f} GB, "
                f"{now - self.began:.0f} s"
            )
            print(line, end="\r" if live else "\n", file=sys.stderr, flush=True)

    def end_line(self) -> None:
        """Keep the last line of a terminal."""
        if self.reported > self.began and sys.stderr.isatty():
            print(file=sys.stderr)


def _name(call: Call) -> str:
    return f"{call[0]}({', '.join(map(shortened, call[1:]))})"


def _listed(game: Game, call: Call) -> list[Any]:
    """What a function of the game returns, as a list of the right form."""
    size, form = FORMS[call[0]]
    listed: list[Any] | None = None
    try:
        found = getattr(game, call[0])(*call[1:])
        if isinstance(found, Iterable):
            entries = iter(found)
            listed = part = list(islice(entries, AT_ONCE))
            while len(part) == AT_ONCE and len(listed) <= MAX_SMALL_STATES:
                needed = len(listed) * (100 + sys.getsizeof(part[-1]))
                check_memory(f"a list of {len(listed):,} entries and more", needed, SMALLER)
                part = list(islice(entries, AT_ONCE))
                listed += part
    except Exception as error:
        error.add_note(f"in {_name(call)} of the game")
        raise
    if listed is not None and len(listed) > MAX_SMALL_STATES:
        raise ValueError(f"{_name(call)} has more than {MAX_SMALL_STATES:,} entries; {SMALLER}")
    if isinstance(found, set | frozenset):  # its order can be another in the next process
        raise ValueError(f"{_name(call)} returned a set, which has no order; give a list of {form}")
    if listed is None or (
        size is not None and not all(isinstance(x, Sized) and len(x) == size for x in listed)
    ):
        raise ValueError(f"{_name(call)} returned {shortened(found)}; give a list of {form}")
    return listed


def _legal(game: Game, state: State, player: int) -> tuple[Hashable, ...]:
    """The legal actions of a player, checked."""
    call = "legal_actions", state, player
    actions = tuple(_listed(game, call))
    fits = False
    with contextlib.suppress(TypeError):  # not hashable
        fits = 0 < len(actions) == len(set(actions))
    if not fits:
        raise ValueError(
            f"{_name(call)} returned {shortened(list(actions))}; give {game.players[player]} a "
            f"list of {FORMS[call[0]][1]}"
        )
    return actions


def _chances(outcomes: Sequence[Any], call: Call) -> list[float]:
    """The probabilities of outcomes, with sum 1."""
    chances = [chance for chance, *_ in outcomes]
    if chances and type(chances[0]) is float and chances == [1.0]:  # most often
        return chances
    if not all(isinstance(chance, int | float | np.integer | np.floating) for chance in chances):
        raise ValueError(f"{_name(call)}: the probabilities {shortened(chances)} are not numbers")
    if not chances:
        raise ValueError(f"{_name(call)} is empty; give at least one state with probability 1")
    total = max(min(sum(chances), 1e300), -1e300)  # of whole numbers of hundreds of digits too
    if not abs(total - 1.0) <= SUM_TOLERANCE or min(chances) < 0.0:
        raise ValueError(
            f"{_name(call)}: the probabilities {shortened(chances)} add up to {total:g}; give "
            "non-negative ones with sum 1"
        )
    return [float(chance / total) for chance in chances]


def _rewards(given: Any, players: tuple[str, ...], call: Call) -> list[float]:
    rewards: list[float] = []
    if not isinstance(given, str | bytes | Mapping):
        with contextlib.suppress(TypeError, ValueError, OverflowError):
            rewards = [float(reward) for reward in given if not isinstance(reward, str | bytes)]
    if len(rewards) != len(players) or not all(abs(reward) <= MOST_REWARD for reward in rewards):
        raise ValueError(
            f"{_name(call)}: rewards {shortened(given)}; give one finite number for each of "
            f"{', '.join(players)}, of at most {MOST_REWARD:g}"
        )
    return rewards
