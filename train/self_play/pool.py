"""The opponent pools of self-play: snapshots, scripted agents, and opponent sampling."""

from __future__ import annotations

import contextlib
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.arrays import Array
from pursuit.simulator.policy import GameView, Policy, play
from pursuit.validation import check, raised
from scripted_agents.games.simulator import GameTask
from train.files import Plain
from train.networks.features import observed
from train.networks.policy import NetworkPolicy
from train.runs.folder import MISFITS
from train.self_play.tables import CellTables
from train.settings.self_play import NASH_SAMPLING, SAMPLING_PARTS
from train.tensors import StateDict, is_whole, read_tensors, write_tensors

LATEST = "latest"
"""The name of the current policy of the opponent, which is always a member."""
MOST_LOADED = 2048
"""Maximum number of snapshots of a role in memory, besides those that play."""
MEMORY = 200.0
"""Approximate number of episodes over which the score against an opponent is averaged."""


@dataclass
class Member:
    """One opponent.

    Attributes:
        name: unique in its pool; the file name of a snapshot.
        loaded: its policy; None for a snapshot that is not in memory.
        scripted: whether it is not a snapshot; these are never dropped.
        read: reads the policy of a snapshot from its file.
        score: the learner's mean score against it in [0, 1]; 0.5 before the first game.
        games: episodes that the learner has played against it.
    """

    name: str
    loaded: Policy | None
    scripted: bool
    read: Callable[[], Policy] | None = None
    score: float = 0.5
    games: float = 0.0

    @property
    def policy(self) -> Policy:
        """Its policy, which stays in memory; ValueError for a damaged snapshot."""
        if self.loaded is None:
            self.loaded = self.policy_once()
        return self.loaded

    def policy_once(self) -> Policy:
        """Its policy, which does not stay in memory if it is not there already."""
        if self.loaded is not None:
            return self.loaded
        assert self.read is not None
        return self.read()


class OpponentPool:
    """The opponents in one role: the latest policy, scripted agents, and snapshots in a folder.

    Args:
        folder: of the snapshots, one .pt file each; its name is the role.
        latest: the learning policy of this role.
        capacity: maximum number of snapshots.
        load: makes a policy from a saved state.
        newest: keep the newest snapshots; otherwise a uniform sample of all snapshots so far.

    Raises:
        ValueError: a capacity below 1.

    Attributes:
        role: of the members.
        members: in order of age, the latest first, then scripted agents, then snapshots.
        offered: snapshots so far, kept or not.
    """

    def __init__(
        self,
        folder: Path,
        latest: Policy,
        capacity: int,
        load: Callable[[StateDict], Policy],
        newest: bool = False,
    ) -> None:
        check(capacity >= 1, f"pool_size={capacity}; give at least 1")
        self.folder, self.capacity, self._load = folder, capacity, load
        self.role, self.newest, self.offered = folder.name, newest, 0
        self.members = [Member(LATEST, latest, True)]

    @property
    def names(self) -> list[str]:
        """The names of all members, in order."""
        return [member.name for member in self.members]

    @property
    def snapshots(self) -> list[Member]:
        """The snapshots, the oldest first."""
        return [member for member in self.members if not member.scripted]

    def add_scripted(self, name: str, policy: Policy) -> None:
        """A member that is never dropped.

        Raises:
            ValueError: the name is taken.
        """
        check(name not in self.names, f"two members of a pool are called {name!r}; rename one")
        place = sum(member.scripted for member in self.members)
        self.members.insert(place, Member(name, policy, True))

    def add(self, name: str, state: StateDict, rng: np.random.Generator) -> str | None:
        """Save and add a snapshot; returns the name of the dropped one, or None.

        A full pool with `newest` drops the oldest. Otherwise it is a reservoir (Vitter, 1985,
        algorithm R): the n-th snapshot replaces a random one with probability capacity / n, so all
        n are in the pool with equal probability. Snapshots that are not added are not saved.

        Raises:
            ValueError: the name is taken.
            OSError: it cannot be written; the pool is unchanged.
        """
        check(name not in self.names, f"two members of a pool are called {name!r}; rename one")
        old, place = self.snapshots, 0
        if len(old) >= self.capacity and not self.newest:
            place = int(rng.integers(self.offered + 1))
            if place >= self.capacity:
                self.offered += 1
                return name
        self.write(name, state)
        self.offered += 1
        self.members.append(Member(name, self._load(state), False, partial(self.read, name)))
        if len(old) < self.capacity:
            return None
        self.members.remove(old[place])
        return old[place].name

    def write(self, name: str, state: StateDict) -> None:
        """Save a snapshot in the folder."""
        self.folder.mkdir(parents=True, exist_ok=True)
        write_tensors(self.folder / f"{name}.pt", state)

    def read(self, name: str) -> Policy:
        """The policy of a snapshot in the folder; ValueError if it is damaged."""
        path = self.folder / f"{name}.pt"
        try:
            return self._load(read_tensors(path))
        except MISFITS as error:
            raise ValueError(f"{path}: not a snapshot of this run ({error}); delete it") from None

    def policies(self, playing: NDArray[np.intp]) -> list[Policy | None]:
        """[members] the policies in memory, those of the members `playing` among them.

        Of more than `MOST_LOADED` snapshots the oldest that do not play are removed from memory.
        Policies with memory stay, as they have a state.
        """
        wanted = [self.members[place] for place in playing.tolist()]
        for member in wanted:
            member.policy  # noqa: B018 -- loads it
        if len(self.members) > MOST_LOADED:
            names = {member.name for member in wanted}
            loaded = [m for m in self.snapshots if m.loaded is not None]
            idle = [m for m in loaded if m.name not in names and not hasattr(m.loaded, "memory")]
            for member in idle[: max(len(loaded) - MOST_LOADED, 0)]:
                member.loaded = None
        return [member.loaded for member in self.members]

    def clean(self) -> None:
        """Delete the files of dropped snapshots, once no checkpoint refers to them."""
        kept = {f"{member.name}.pt" for member in self.snapshots}
        for path in self.folder.glob("*.pt"):
            if path.name not in kept:
                path.unlink()

    def note(self, opponents: NDArray[np.int64], scores: NDArray[np.float64]) -> None:
        """Record scores [n] in [0, 1] of episodes of the learner against members by index [n]."""
        for opponent, score in zip(opponents.tolist(), scores.tolist(), strict=True):
            one = self.members[opponent]
            one.games += 1.0
            one.score += (score - one.score) / min(one.games, MEMORY)

    def described(self) -> list[Plain]:
        """The members with their scores, as plain values."""
        return [
            {"name": m.name, "scripted": m.scripted, "score": m.score, "games": m.games}
            for m in self.members
        ]

    def state_dict(self) -> StateDict:
        """The state of the pool, without the snapshots, which are on disk."""
        return {"members": self.described(), "offered": self.offered}

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state; snapshots are loaded when they are used.

        Missing or damaged snapshots are left out, with a warning.

        Raises:
            KeyError: other scripted members than those of this pool.
        """
        scripted = {member.name: member for member in self.members}
        members = []
        for entry in state["members"]:
            name = entry["name"]
            if entry["scripted"]:
                member = scripted[name]
            else:
                path = self.folder / f"{name}.pt"
                if not is_whole(path):
                    warnings.warn(
                        f"{path}: damaged or missing snapshot, left out of the pool", stacklevel=2
                    )
                    continue
                member = Member(name, None, False, partial(self.read, name))
            member.score, member.games = entry["score"], entry["games"]
            members.append(member)
        self.members, self.offered = members, state["offered"]


def weights(
    pool: OpponentPool,
    sampling: str,
    window: int = 5,
    power: float = 2.0,
    mixture: NDArray[np.float64] | None = None,
    payoffs: object = None,
    progress: float = 0.0,
) -> NDArray[np.float64]:
    """[members] float64 with sum 1: the sampling probabilities.

    Args:
        pool: the pool.
        sampling: "latest": the current opponent. "window": uniform over that one and the last
            `window` snapshots. "uniform": uniform over all (fictitious self-play; Heinrich et al.,
            2015). "pfsp": by (1 - score) ** `power`, the learner's score against each: prioritised
            fictitious self-play (Vinyals et al., 2019). "nash-mixture" and "psro": by
            `mixture`, a Nash equilibrium of the payoff matrix (the restricted game of McMahan et
            al., 2003); until there is one, the latest. Scripted members are included in all but
            "latest", in the last two by the mixture.
            Any other name is a user-defined function (pool, payoffs, progress) -> [members].
        window: number of snapshots of "window".
        power: exponent of "pfsp"; larger values prefer stronger opponents.
        mixture: [members] of "nash-mixture" and "psro".
        payoffs: the `Payoffs` for a user-defined function.
        progress: share of the budget used, in [0, 1], for a user-defined function.

    Raises:
        ValueError: an empty pool, or a user-defined function that fails or returns invalid
            probabilities.
    """
    members = pool.members
    check(bool(members), f"{pool.folder}: the pool is empty; add a member")
    chosen = np.zeros(len(members))
    if sampling in NASH_SAMPLING and mixture is not None:
        chosen[:] = mixture
    elif sampling in ("latest", *NASH_SAMPLING):
        chosen[0] = 1.0
    elif sampling == "pfsp":
        chosen[:] = [(1.0 - member.score) ** power for member in members]
        chosen += 1e-3 * max(float(chosen.max()), 1e-6)
    elif sampling in ("uniform", "window"):
        chosen[:] = 1.0
        if sampling == "window":
            old = len(pool.snapshots) - window
            first = sum(member.scripted for member in members)
            chosen[first : first + max(old, 0)] = 0.0
    else:
        chosen = _custom_weights(sampling, pool, payoffs, progress)
    return np.asarray(chosen / chosen.sum())


def _custom_weights(sampling: str, pool: OpponentPool, payoffs: object, progress: float) -> Array:
    """[members]: what a user-defined function returns; ValueError as `weights`."""
    members, chosen = pool.members, np.zeros(0)
    try:
        returned = SAMPLING_PARTS.get(sampling)(pool, payoffs, progress)
    except Exception as error:  # the function may raise anything
        line = traceback.extract_tb(error.__traceback__, limit=2)[-1]
        raise ValueError(
            f"sampling {sampling!r} raised {raised(error)} "
            f"({Path(line.filename).name}:{line.lineno}); mend it"
        ) from error
    with contextlib.suppress(TypeError, ValueError):
        chosen = np.asarray(returned)  # not as float64, so that text and complex numbers are found
    check(
        chosen.dtype.kind in "biuf"
        and chosen.shape == (len(members),)
        and 0.0 < chosen.sum() < inf
        and chosen.min() >= 0.0,
        f"sampling {sampling!r} returned {returned!r} for {len(members)} members of the pool; "
        "return one finite probability of at least 0 for each, with a positive sum",
    )
    return chosen


class PoolPolicy:
    """A policy that plays a possibly different member of a pool in every game.

    Args:
        pool: the pool.
        num_games: of the batch.
        steps: approximate number of steps between updates of the member that learns.

    Attributes:
        opponents: [num_games] int64, the index in `pool.members` of the opponent of each game.
        tables: action tables of the members that have them.
    """

    def __init__(self, pool: OpponentPool, num_games: int, steps: int = 1) -> None:
        self.pool = pool
        self.opponents = np.zeros(num_games, dtype=np.int64)
        self.tables = CellTables(num_games * steps)

    def recurrent_members(self) -> dict[str, Policy]:
        """The members with memory, by name. Snapshots have one if the latest policy has one."""
        latest = hasattr(self.pool.members[0].policy, "memory")
        policies = {m.name: m.policy for m in self.pool.members if m.scripted or latest}
        return {name: policy for name, policy in policies.items() if hasattr(policy, "memory")}

    def all_tables(self, task: GameTask) -> NDArray[np.float64] | None:
        """[members, states, actions] the tables of all members; None if one has none."""
        policies: list[Any] = self.pool.policies(np.arange(len(self.pool.members)))
        places = self.tables.places(policies, task)
        return self.tables.cumulative[places] if (places >= 0).all() else None

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32 actions: drawn from tables if available (see `CellTables`), otherwise
        by one forward pass per distinct opponent."""
        present = np.flatnonzero(np.bincount(self.opponents))
        policies: list[Any] = self.pool.policies(present)
        places = self.tables.places(policies, view.task)
        if len(present) == 1:
            policy = policies[present[0]]
            if places[present[0]] < 0:
                return play(policy, view)
            draws = np.zeros(view.num_games) if policy.greedy else view.uniform()
            return self.tables.draw(places[self.opponents], view, slice(None), draws)
        draws = view.uniform()
        if (places[present] >= 0).all():
            return self.tables.draw(places[self.opponents], view, slice(None), draws)
        actions = np.empty(view.num_games, dtype=np.int32)
        order = np.argsort(self.opponents, kind="stable")
        bounds = np.searchsorted(self.opponents[order], [*present, len(policies)])
        looks: dict[str, Array] = {}
        for place, first, last in zip(present, bounds, bounds[1:], strict=False):
            games, policy = order[first:last], policies[place]
            if places[place] >= 0:
                which = places[self.opponents[games]]
                actions[games] = self.tables.draw(which, view, games, draws[games])
            elif isinstance(policy, NetworkPolicy):
                if policy.encoding not in looks:
                    looks[policy.encoding] = observed(view, policy.encoding)
                seen = looks[policy.encoding][games]
                allowed = policy.seat.masks(view)
                actions[games] = policy.choose(
                    view,
                    seen,
                    None if policy.greedy else draws[games],
                    None if allowed is None else allowed[games],
                )
            else:
                part = view.select(games)
                actions[games] = play(policy, part)
                view.streams[games] = part.streams
        return actions
