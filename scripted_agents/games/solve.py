"""Exact values, best responses and equilibria of enumerated games."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import number, shortened, whole
from scripted_agents.exact.joint.layout import NO_SLIPS, Store
from scripted_agents.exact.joint.results import Equilibrium, JointNashConv, SolvedGame
from scripted_agents.exact.joint.shapley_iteration import StochasticGame, solve_stochastic_game
from scripted_agents.exact.long_work import report
from scripted_agents.exact.tolerances import EQUAL_VALUES, SMALL_GAME_TOLERANCE, TIE
from scripted_agents.games.small_game import DRAWN, Behaviour, SmallGame, check_game

if TYPE_CHECKING:  # slow to import
    from scipy.sparse import csr_array

MOST_SWEEPS = 3000
"""Of value iteration, enough for a discount of 0.99; then linear equations are solved."""

Policies = Mapping[str, Behaviour]
Values = NDArray[np.float64]
Sweep = Callable[[Values], Values]


class _Tables(SolvedGame):
    """A solution of a small game; `mean` and `tables` are short names of its attributes."""

    @property
    def mean(self) -> float:
        """`mean_over_starts`."""
        return self.mean_over_starts

    @property
    def tables(self) -> dict[str, Values]:
        """`policies`."""
        return self.policies


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallResponse(_Tables):
    """The result of `respond`.

    Attributes:
        players: the responding players, which act as one.
        values: [states] float64, the expected discounted sum of their rewards from each state on.
        mean_over_starts: the mean of `values` over the starts; also `mean`.
        policies: by player, its policy as in `SmallGame.table`; with a horizon that of the first
            step; also `tables`.
        uniform: of a single player, as `policies`, the policy that plays all its optimal actions
            with the same probability; empty for several players.
    """

    players: tuple[str, ...]
    uniform: dict[str, Values]


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallEquilibrium(_Tables, Equilibrium):
    """The result of `equilibrium`.

    Attributes:
        values: [states] float64, the value of each state for the first player.
        mean_over_starts: the mean of `values` over the starts; also `mean`.
        policies: by player, an optimal policy as in `SmallGame.table`; with a horizon that of the
            first step; also `tables`.
        mixed: [states] bool, whether no pure strategies are optimal.
    """


def returns_of(
    game: SmallGame, policies: Policies, discount: float = 0.95, horizon: int | None = None
) -> Values:
    """[states, players] float64: the expected discounted returns when all play these policies.

    Args:
        game: the game.
        policies: by player; see `SmallGame.table`.
        discount: of each step, above 0 and at most 1; below 1 without a horizon.
        horizon: number of steps, or None for infinitely many.

    Raises:
        ValueError: an invalid argument, or a policy that is missing or no distribution.
    """
    check_objective(discount, horizon)
    step, rewards = chain_of(game, policies)

    def back_up(values: Values) -> Values:
        return rewards + discount * (step @ values)

    return iterate(
        back_up, rewards, discount, horizon, lambda values: _solved(step, rewards, discount)
    )


def chain_of(game: SmallGame, policies: Policies) -> tuple[csr_array, Values]:
    """The game when all play these policies: [states, states] the probability of each next state,
    and [states, players] the expected rewards of a step; errors are those of `returns_of`."""
    from scipy.sparse import csr_array  # slow to import

    check_game(game)
    chances = joint_chances(game, policies, game.players)
    weights = csr_array((chances, (game.owners, np.arange(len(chances)))))
    return weights @ game.following, np.asarray(weights @ game.rewards)


class Replies(NamedTuple):
    """What a player, or several as one, can choose in each state against fixed policies.

    Attributes:
        options: [states + 1] int64, the first option of each state; options are the joint choices
            of the players, the last player's counting fastest.
        sizes: [states, players] int64, how many choices each has.
        step: [options, states] the chances of the next states.
        rewards: [options] float64, the expected sum of their rewards.
    """

    options: NDArray[np.int64]
    sizes: NDArray[np.int64]
    step: csr_array
    rewards: Values

    def all_best(self, later: Values, discount: float, tie: float) -> NDArray[np.bool_]:
        """[options] whether an option is best up to `tie`, with values [states] `later` of the next
        step."""
        worth = self.rewards + discount * (self.step @ later)
        best = np.maximum.reduceat(worth, self.options[:-1])
        slack = tie * np.maximum(1.0, np.abs(best))
        return np.asarray(worth >= np.repeat(best - slack, np.diff(self.options)))

    def best(self, later: Values, discount: float, tie: float) -> NDArray[np.int64]:
        """[states] the first option of `all_best`."""
        good = np.flatnonzero(self.all_best(later, discount, tie))
        return np.asarray(good[np.searchsorted(good, self.options[:-1])])


def replies_of(game: SmallGame, team: Sequence[str], policies: Policies) -> Replies:
    """The replies of `team` to the policies of all other players."""
    from scipy.sparse import csr_array  # slow to import

    indices = [game.player(name) for name in team]
    others = [name for name in game.players if name not in team]
    chances = joint_chances(game, policies, others)
    sizes = np.stack([np.diff(game.offsets(index)) for index in indices], axis=1)
    options = np.concatenate([[0], np.cumsum(sizes.prod(axis=1))])
    state = game.owners
    option = np.zeros(len(state), dtype=np.int64)
    for place, index in enumerate(indices):
        option = option * sizes[state, place] + game.choices[:, index]
    option += options[state]
    weights = csr_array((chances, (option, np.arange(len(state)))), shape=(options[-1], len(state)))
    rewards = weights @ game.rewards[:, indices].sum(axis=1)
    return Replies(options, sizes, weights @ game.following, rewards)


def respond(
    game: SmallGame,
    players: str | Sequence[str],
    policies: Policies,
    discount: float = 0.95,
    horizon: int | None = None,
) -> SmallResponse:
    """The best response of a player, or of several as one with the sum of their rewards.

    Backward induction or value iteration (Bellman, 1957; Puterman, 1994), for discounts near 1
    policy iteration (Howard, 1960). Arguments and errors are those of `returns_of`; `policies` are
    those of all other players.
    """
    check_objective(discount, horizon)
    given = [players] if isinstance(players, str) else players
    team = tuple(given) if isinstance(given, Sequence) else ()
    check_game(game)
    indices = [game.player(name) for name in team]
    if not team or len(set(team)) < len(team):
        raise ValueError(f"players={players!r}; give one player, or several different ones")
    replies = replies_of(game, team, policies)
    options, sizes, step, rewards = replies

    def back_up(values: Values) -> Values:
        return np.maximum.reduceat(rewards + discount * (step @ values), options[:-1])

    def improved(values: Values) -> Values:
        """Policy iteration; every policy is better than the last."""
        while True:
            chosen = replies.best(values, discount, 0.0)
            before, values = values, _solved(step[chosen], rewards[chosen], discount)
            largest = max(1.0, float(np.abs(values).max()))
            if (values - before).max() <= SMALL_GAME_TOLERANCE * largest:
                return values

    nothing = np.zeros(game.num_states)
    values = later = iterate(back_up, nothing, discount, horizon, improved)
    if horizon is not None:
        later = iterate(back_up, nothing, discount, horizon - 1, improved)
    first = replies.best(later, discount, TIE) - options[:-1]
    tables = {}
    for place in range(len(team) - 1, -1, -1):
        offsets = game.offsets(indices[place])
        table = np.zeros(offsets[-1])
        table[offsets[:-1] + first % sizes[:, place]] = 1.0
        tables[team[place]], first = table, first // sizes[:, place]
    uniform = {}
    if len(team) == 1:
        good = replies.all_best(later, discount, EQUAL_VALUES).astype(np.float64)
        many = np.add.reduceat(good, options[:-1])
        uniform[team[0]] = good / np.repeat(many, np.diff(options))
    mean = float(game.start @ values)
    return SmallResponse(
        values=values, mean_over_starts=mean, policies=tables, players=team, uniform=uniform
    )


def nash_conv(
    game: SmallGame, policies: Policies, discount: float = 0.95, horizon: int | None = None
) -> JointNashConv:
    """What every player's best response gains against the policies of all others, over the starts.

    NashConv is the sum of the gains (Lanctot et al., 2017). Arguments and errors are those of
    `returns_of`.
    """
    returns = returns_of(game, policies, discount, horizon)
    best = {
        player: respond(game, player, policies, discount, horizon).mean_over_starts
        for player in game.players
    }
    own = (game.start @ returns).tolist()
    return JointNashConv(dict(zip(game.players, own, strict=True)), best)


def equilibrium(
    game: SmallGame, discount: float = 0.95, horizon: int | None = None
) -> SmallEquilibrium:
    """The value and an equilibrium of a zero-sum game of two players.

    Shapley (1953): value iteration in which every state is a matrix game, with steps of policy
    evaluation in between where they help (Pollatschek and Avi-Itzhak, 1969).

    Args:
        game: of two players with rewards that add up to 0.
        discount: of each step, above 0 and at most 1; below 1 without a horizon.
        horizon: number of steps, or None for infinitely many.

    Raises:
        ValueError: another number of players, rewards that do not add up to 0, or an invalid
            discount or horizon.
    """
    check_objective(discount, horizon)
    check_zero_sum(game)
    many = [max(map(len, actions)) for actions in game.actions]
    store, lotteries = _store(game, many[1])
    tell = partial(report, f"solving {game.num_states:,} states")
    played = StochasticGame(store, (many[0], many[1]), discount, None, lotteries, tell)
    values, _ = solve_stochastic_game(played, horizon)
    tables = {}
    for player, (name, dense) in enumerate(zip(game.players, played.strategies(), strict=True)):
        sizes = np.diff(game.offsets(player))
        tables[name] = dense[np.arange(many[player]) < sizes[:, None]]
    mean, mixed = float(game.start @ values), played.mixed
    return SmallEquilibrium(values=values, mean_over_starts=mean, policies=tables, mixed=mixed)


def check_objective(discount: float, horizon: int | None) -> None:
    """ValueError for a discount or a horizon that is not allowed."""
    if horizon is not None:
        whole("horizon", horizon, 1)
    if not 0.0 < number("discount", discount) <= 1.0 or (horizon is None and discount == 1.0):
        raise ValueError(
            f"discount={discount}, horizon={horizon}; give a discount above 0 and below 1, or a "
            "horizon with a discount of at most 1"
        )


def check_zero_sum(game: SmallGame) -> None:
    """ValueError unless it is an enumerated game of two players with opposite rewards."""
    check_game(game)
    if len(game.players) != 2:
        raise ValueError(
            f"{len(game.players)} players; equilibria are computed for two with opposite rewards. "
            "nash_conv is defined for any number"
        )
    if game.unbalanced.any():
        joint = int(np.argmax(game.unbalanced))
        state = game.states[game.owners[joint]]
        raise ValueError(
            f"in {shortened(state)} the rewards are {game.rewards[joint].tolist()}; equilibria are "
            "computed for two players with opposite rewards"
        )


def check_policies(game: SmallGame, policies: Mapping[str, object], players: Sequence[str]) -> None:
    """ValueError if one of these players has no policy, or a policy is of an unknown player."""
    if not isinstance(policies, Mapping):
        raise ValueError(
            f"policies={shortened(policies)}; give a dict with a policy of each player"
        )
    for name in policies:
        game.player(name)
    for name in players:
        if name not in policies:
            raise ValueError(f"player {name} has no policy; add policies[{name!r}]")


def joint_chances(game: SmallGame, policies: Policies, players: Sequence[str]) -> Values:
    """[joint actions] float64: the probability of the choices of these players.

    Raises:
        ValueError: a policy that is missing or no distribution, or one of an unknown player.
    """
    check_policies(game, policies, players)
    chances = np.ones(len(game.choices))
    for name in players:
        index, table = game.player(name), game.table(name, policies[name])
        chances *= table[game.offsets(index)[game.owners] + game.choices[:, index]]
    return chances


def _store(game: SmallGame, columns: int) -> tuple[Store, csr_array]:
    """The transitions as `StochasticGame` takes them, for the payoff of the first player."""
    from scipy.sparse import csr_array  # slow to import

    after, states = game.after.copy(), game.num_states
    drawn = np.flatnonzero(after == DRAWN)
    after[drawn] = states + np.arange(len(drawn))
    sizes = np.array([len(actions) for actions in game.actions[0]])
    ones = np.ones(states)
    shape = np.stack([np.diff(game.begins), ones, sizes, ones], axis=1).astype(np.int32)
    joints = game.choices[:, 0].astype(np.int64) * columns + game.choices[:, 1]
    small = np.int16 if joints.max() <= np.iinfo(np.int16).max else np.int32
    rewards = np.ascontiguousarray(game.rewards[:, 0])
    store = Store(game.begins, game.begins, shape, after, rewards, joints.astype(small), *NO_SLIPS)
    return store, csr_array(game.following[drawn])


def iterate(
    back_up: Sweep, start: Values, discount: float, horizon: int | None, solve: Sweep
) -> Values:
    """Backward induction from values of 0, or value iteration until they are exact.

    `solve` makes exact values of those of `MOST_SWEEPS` sweeps, where these are not enough.
    """
    values = np.zeros_like(start)
    tolerance = SMALL_GAME_TOLERANCE * (1.0 - discount) if horizon is None else 0.0
    for _ in range(MOST_SWEEPS if horizon is None else horizon):
        before, values = values, back_up(values)
        change = np.abs(values - before).max(initial=0.0)
        largest = max(1.0, float(np.abs(values).max(initial=0.0)))
        if change <= tolerance * largest:
            return values
    return solve(values) if horizon is None else values


def _solved(step: csr_array, rewards: Values, discount: float) -> Values:
    """The values of these rewards [states, ...] with the probabilities `step` [states, states]."""
    from scipy.sparse import csc_array, eye_array  # slow to import
    from scipy.sparse.linalg import splu

    return np.asarray(splu(csc_array(eye_array(len(rewards)) - discount * step)).solve(rewards))
