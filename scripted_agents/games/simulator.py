"""The class `GameSimulator`, which steps many copies of an enumerated game at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.memory import check_memory
from pursuit.rules.arrays import Array
from pursuit.rules.randomness import uniform_numbers
from pursuit.simulator.batch import Batch, Rules
from pursuit.simulator.next_episode import fill_epsilon, game_indices
from pursuit.simulator.state import SimulatorState, check_range
from pursuit.validation import as_array, check, one_of, shortened, whole
from scripted_agents.games import tables
from scripted_agents.games.encoding import encoded_states
from scripted_agents.games.small_game import SmallGame, check_game

INDEX, ONE_HOT, OBSERVE = "index", "one_hot", "observe"
ENCODINGS = (INDEX, ONE_HOT, OBSERVE)
"""Observations of a game: the number of the state, a vector with 1 at this number, and what the
function `observe` of the game returns."""


@dataclass(frozen=True, eq=False)
class GameTask(Rules):
    """An enumerated game with a time limit: what simulators, environments and training play.

    Attributes:
        game: the game.
        name: of the game.
        max_steps: steps after which an episode is truncated.
        observed: by seat, the arrays of "observe" so far; see `observations`.
    """

    game: SmallGame
    name: str = "game"
    max_steps: int = 200
    observed: dict[int, Array] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        check_game(self.game)
        whole("max_steps", self.max_steps, 1)

    @property
    def agent_names(self) -> tuple[str, ...]:
        """The names of the players, which are also their roles."""
        return self.game.players

    def seat(self, player: str | int) -> int:
        """The index of a player, by name or index; ValueError if there is none."""
        if isinstance(player, str):
            return self.game.player(player)
        return whole("player", player, 0, self.num_agents - 1)

    def num_actions(self, player: str | int) -> int:
        """The number of different actions of a player."""
        return len(self.game.action_lists[self.seat(player)])

    def horizon(self, discount: float) -> int | None:
        """The horizon of exact results: the time limit, None with a discount."""
        return self.max_steps if discount == 1.0 else None

    @cached_property
    def tables(self) -> tables.StepTables:
        """The transitions for the simulator."""
        return tables.step_tables(self.game)

    def legal(self, player: str | int) -> NDArray[np.bool_]:
        """[states, actions] bool: which actions of a player are legal."""
        seat = self.seat(player)
        return np.asarray(self.tables.places[seat, :, : self.num_actions(seat)] >= 0)

    def flat(self, player: str | int, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """A table as of `SmallGame.table` from [states, actions] probabilities by the numbers of
        actions."""
        seat = self.seat(player)
        places, offsets = self.tables.places[seat], self.game.offsets(seat)
        state, number = np.nonzero(places >= 0)
        found = np.empty(offsets[-1])
        # Legal actions can be in another order than their numbers.
        found[offsets[state] + places[state, number]] = rows[state, number]
        return found

    def rows(
        self, player: str | int, table: NDArray[np.float64], states: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """[n, actions]: the probabilities by the numbers of actions in `states` [n], from a table
        as of `flat`."""
        seat = self.seat(player)
        places = self.tables.places[seat, states, : self.num_actions(seat)]
        firsts = self.game.offsets(seat)[states]
        return np.where(places >= 0, table[np.where(places >= 0, firsts[:, None] + places, 0)], 0.0)

    def observations(self, player: str | int, encoding: str = INDEX) -> Array:
        """[states, *shape]: what a player observes in every state, computed once.

        The shape is [1] int32 for "index", [states] float32 for "one_hot", and for "observe" that
        of the arrays of the game, as float32.

        Raises:
            ValueError: an unknown encoding, a game without `observe`, arrays of different shapes,
                numbers that are not finite, or too little memory.
        """
        one_of("observation", encoding, ENCODINGS)
        seat, states = self.seat(player), self.game.num_states
        if encoding == INDEX:
            return np.arange(states, dtype=np.int32)[:, None]
        if encoding == ONE_HOT:
            check_memory(f"one_hot of {states:,} states", 4 * states**2, "use observation index")
            return np.eye(states, dtype=np.float32)
        if seat not in self.observed:
            function: Any = getattr(self.game.source, "observe", None)
            check(
                callable(function),
                f"observation='observe', but game {self.name!r} has no function observe(state, "
                "player); write one, or use index or one_hot",
            )
            self.observed[seat] = encoded_states(self.game.states, "observe", function, seat)
        return self.observed[seat]

    @cached_property
    def waiting(self) -> NDArray[np.bool_]:
        """[players, states] bool: whether a player is not to move, as its only action is None."""
        return np.array([[tuple(row) == (None,) for row in rows] for rows in self.game.actions])

    def __deepcopy__(self, memo: dict[int, object]) -> GameTask:
        """Itself, as it never changes: policies of a game play in copies of its simulators."""
        return self


@dataclass(frozen=True, eq=False)
class StateView:
    """A batch of games as seen by one player: live arrays of the `GameSimulator`, not copies.

    Attributes:
        task: the game.
        seat: the index of the player.
        state: [num_games] int32, the number of the state.
        steps: [num_games] int32, steps of the episode so far.
        streams: [num_games, ...] uint64, the random streams; a policy draws from its stream only.
        epsilon: [num_games, players] float64, the probability of a uniformly random action; NaN if
            that of the policy applies.
        observe: `observe(encoding)` -> [num_games, ...], the observations of the player.
    """

    task: GameTask
    seat: int
    state: NDArray[np.int32]
    steps: NDArray[np.int32]
    streams: NDArray[np.uint64]
    epsilon: NDArray[np.float64]
    observe: Callable[[str], Array]

    @property
    def num_games(self) -> int:
        """Number of games in the batch."""
        return len(self.state)

    def table_rows_of(self, games: NDArray[np.intp] | slice) -> NDArray[np.int32]:
        """[n] int32: the states of some games, which are the rows of tables of policies."""
        return self.state[games]

    def select(self, games: NDArray[np.intp]) -> StateView:
        """A view of copies of these games; see `pursuit.simulator.policy.GameView.select`."""
        names = "state", "steps", "streams", "epsilon"
        parts = {name: getattr(self, name)[games] for name in names}
        return replace(self, observe=lambda encoding: self.observe(encoding)[games], **parts)

    def uniform(self) -> NDArray[np.float64]:
        """[num_games] float64 in [0, 1), from the player's own random stream, which advances."""
        return uniform_numbers(self.streams, tables.FIRST_PLAYER_STREAM + self.seat)


class OpponentTables(NamedTuple):
    """The opponents of a player in a game of two as tables.

    Attributes:
        cumulative: [opponents, states, actions] float64, sums of the probabilities over the actions
            by their numbers.
        members: [games] int64, the opponent of every game; changed where games restart.
        shares: [opponents] float64, the probabilities with which new opponents are drawn.
    """

    cumulative: NDArray[np.float64]
    members: NDArray[np.int64]
    shares: NDArray[np.float64]


class StatePolicy(Protocol):
    """A policy of a player that depends on the state only."""

    def act(self, view: StateView) -> NDArray[np.int32]:
        """[num_games] int32, the number of an action for every game."""
        ...

    def table(self, task: GameTask) -> NDArray[np.float64]:
        """The probabilities in all states of a game, as of `SmallGame.table`."""
        ...


class GameSimulator(Batch[GameTask]):
    """A batch of copies of a game, stepped together by table look-ups.

    As in `pursuit.Simulator`, a game restarts in the step that ends its episode, and the results of
    that episode remain available. Game i of a batch with seed s is identical to a single game with
    `seed=s, first_game=i`. Rewards are the expected ones of the joint action.

    Args:
        task: the game.
        num_games: number of games in the batch.
        seed: 0 to 2**64 - 1.
        first_game: the index of the first game of this batch.
        auto_restart: if False, ended games keep their state and flags, with rewards of 0, until
            `reset`.

    Raises:
        ValueError: counts or seeds out of range, or not enough memory.

    Attributes (arrays that every step overwrites in place; copy them to keep them):
        state: [num_games] int32, the number of the state; after the end of an episode that before
            the last step.
        steps: [num_games] int32, steps of the episode so far.
        rewards: [num_games, players] float32, of the last step.
        returns: [num_games, players] float64, the sum of rewards of the episode so far.
        terminated, truncated: [num_games] bool, of the last step; never both.
        episode_returns: [num_games, players] float64, of each game's last finished episode.
        episode_lengths, final_state: [num_games] int32, likewise.
        epsilon: [num_games, players] float64, the probability of a uniformly random action of each
            player whose policy is a `TableAgent`; NaN uses the epsilon of the policy.
        next_epsilon: the same from the next episode on; -1 for no change.
        streams: [num_games, 2 + players] uint64, the random streams.
        last_seed: the last seed of all streams; None after `set_state`.
    """

    PLAYS_TABLES: ClassVar[bool] = True

    def __init__(
        self,
        task: GameTask,
        num_games: int = 1,
        seed: int = 0,
        first_game: int = 0,
        auto_restart: bool = True,
    ) -> None:
        if not isinstance(task, GameTask):
            raise ValueError(f"task={task!r}; give a GameTask")
        super().__init__(task, num_games, seed, first_game, auto_restart)
        count, players = self.num_games, task.num_agents
        check_memory(f"num_games={count}", count * (60 + 60 * players), "take fewer games")
        self.streams = np.zeros((count, 2 + players), dtype=np.uint64)
        numbers = np.zeros((4, count), dtype=np.int32)
        self.state, self._steps, self.episode_lengths, self.final_state = numbers
        self.rewards = np.zeros((count, players), dtype=np.float32)
        self.returns, self.episode_returns = np.zeros((2, count, players))
        self.terminated, self.truncated = np.zeros((2, count), dtype=bool)
        self.epsilon = np.full((count, players), np.nan)
        self.next_epsilon = np.full((count, players), tables.UNCHANGED)
        self._joints = np.zeros(count, dtype=np.int64)
        self._arrays: tables.Copies = tables.Copies(
            self.streams, self.state, self._steps, self.rewards, self.returns, self.terminated,
            self.truncated, self.episode_returns, self.episode_lengths, self.final_state,
            self.epsilon, self.next_epsilon,
        )  # fmt: skip
        self._views: dict[int, StateView] = {}
        self.reset(seed)

    @property
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps of the episode so far."""
        return self._steps

    def _start(self, chosen: NDArray[np.bool_]) -> None:
        tables.start_games(chosen, *self.task.tables, *self._arrays)

    def step(self, actions: ArrayLike) -> None:
        """Step all games. Results are in the attributes.

        Args:
            actions: [num_games, players] integers, numbers of legal actions.

        Raises:
            ValueError: a wrong shape or dtype, or an illegal action. Then no game moves.
        """
        task, shape = self.task, (self.num_games, self.task.num_agents)
        chosen = as_array("actions", actions, "iu", "give integers")
        if chosen.shape != shape:
            raise ValueError(f"actions of shape {chosen.shape}; [num_games, players] is {shape}")
        if chosen.dtype != np.int32:
            chosen = np.clip(chosen.astype(np.int64, copy=False), -1, 2**31 - 1)
        chosen = np.ascontiguousarray(chosen, dtype=np.int32)
        rule = self._joints, chosen, task.max_steps, self.auto_restart
        wrong = tables.step_games(*rule, *task.tables, *self._arrays)
        if wrong != tables.OK:
            game, seat = divmod(wrong, task.num_agents)
            raise ValueError(self.why_illegal(game, seat, int(chosen[game, seat])))

    def play(
        self,
        seats: tuple[int, int],
        draws: NDArray[np.float64],
        own: NDArray[np.float64],
        opponents: OpponentTables,
    ) -> tables.Played:
        """Play some steps of a game of two by tables, with restarts; as `tables.play_steps`.

        Args:
            seats: of the player of `own`, and of its opponent.
            draws: [2, steps, games] in [0, 1).
            own: [states, actions], sums of the probabilities over the actions.
            opponents: the tables of its opponents.
        """
        shape = draws.shape[1:]
        state, final, lengths = np.zeros((3, *shape), dtype=np.int32)
        action, members = np.zeros((2, *shape), dtype=np.int64)
        over, cut = np.zeros((2, *shape), dtype=np.bool_)
        reward, returns = np.zeros(shape, dtype=np.float32), np.zeros((*shape, 2))
        played = tables.Played(state, action, reward, over, cut, final, returns, lengths, members)
        actions, sums = np.zeros((shape[1], 2), dtype=np.int32), np.cumsum(opponents.shares)
        how = self._joints, actions, self.task.max_steps, np.array(seats), draws, own
        against = opponents.cumulative, opponents.members, sums
        tables.play_steps(*how, *against, played, *self.task.tables, *self._arrays)
        return played

    def why_illegal(self, game: int, seat: int, action: int) -> str:
        """The message for an illegal action."""
        state, every = int(self.state[game]), self.task.game.action_lists[seat]
        legal = np.flatnonzero(self.task.tables.places[seat, state] >= 0).tolist()
        named = shortened({number: every[number] for number in legal})
        return (
            f"action {action} of {self.task.agent_names[seat]} in game {game} is not legal in "
            f"{shortened(self.task.game.states[state])}; the legal ones are {named}"
        )

    # -- the next episode ------------------------------------------------------------------------

    def configure(
        self,
        games: ArrayLike | None = None,
        *,
        epsilon: ArrayLike | None = None,
        seat: int | str | None = None,
    ) -> None:
        """Change the probability of random actions of all games, or of `games`, from their next
        restart on.

        Args:
            games: a bool mask or index list; default: all.
            epsilon: of the player `seat` (default: all), in [0, 1]; a number, [games], or without
                `seat` [games, players].
            seat: a player, by name or index.

        Raises:
            ValueError: a value out of range; nothing is changed then.
        """
        chosen = game_indices(games, self.num_games)
        if epsilon is not None:
            changed = self.next_epsilon[chosen]
            seats = slice(None) if seat is None else self.task.seat(seat)
            fill_epsilon(changed[:, seats], epsilon)
            self.next_epsilon[chosen] = changed

    def _live(self) -> dict[str, Array]:
        results = "rewards", "episode_lengths", "final_state"
        every = self._arrays._asdict()
        return {name: array for name, array in every.items() if name not in results}

    def _check_values(self, state: SimulatorState) -> None:
        check_range(state, "state", 0, self.task.game.num_states - 1)
        check_range(state, "steps", 0, self.task.max_steps)

    # -- observations and policies ---------------------------------------------------------------

    def observe(self, encoding: str = INDEX, seat: int | str = 0) -> Array:
        """[num_games, ...] the observations of a player; see `GameTask.observations`."""
        number = self.task.seat(seat)
        if encoding == INDEX:
            return self.state[:, None].copy()
        if encoding != ONE_HOT:
            return self.task.observations(number, encoding)[self.state]
        seen = np.zeros((self.num_games, self.task.game.num_states), dtype=np.float32)
        seen[np.arange(self.num_games), self.state] = 1.0
        return seen

    def view(self, seat: int | str) -> StateView:
        """The view of the games for the policy of a player."""
        number = self.task.seat(seat)
        if number not in self._views:
            live = self.state, self.steps, self.streams, self.epsilon
            observe = partial(self.observe, seat=number)
            self._views[number] = StateView(self.task, number, *live, observe)
        return self._views[number]
