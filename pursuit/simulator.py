"""Simulator: thousands of games in lockstep, as arrays over the rule book's rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit import rules
from pursuit.maze import MAX_TABLE_CELLS, Maze
from pursuit.observations import Encoder
from pursuit.policy import GameView, Policy
from pursuit.task import Task


@dataclass(frozen=True)
class MazeArrays:
    """Mazes laid end to end for the kernels; the columns are named in the rule book.

    Attributes:
        mazes: [num_mazes, ...] int64, where each maze begins and its marks.
        cells: [all cells, 9] int32, neighbours, row, column, distance to the nearest goal mark,
            mask of moves.
        tables: uint16, the distance tables of all mazes that have one, flattened.
    """

    mazes: NDArray[np.int64]
    cells: NDArray[np.int32]
    tables: NDArray[np.uint16]


@lru_cache(maxsize=64)
def lay_out(mazes: tuple[Maze, ...]) -> MazeArrays:
    """The arrays of `mazes`; mazes of more than MAX_TABLE_CELLS cells get no distance table."""
    num_marks = max(len(maze.goal_marks) for maze in mazes)
    table = np.full((len(mazes), rules.FIRST_GOAL_MARK + num_marks), -1, dtype=np.int64)
    cells, distances = [], [np.zeros(0, dtype=np.uint16)]
    num_cells = num_distances = 0
    for row, maze in zip(table, mazes, strict=True):
        row[rules.CELL_OFFSET], row[rules.CELL_COUNT] = num_cells, maze.num_cells
        if maze.start_mark is not None:
            row[rules.START_MARK] = maze.start_mark
        row[rules.NUM_GOAL_MARKS] = len(maze.goal_marks)
        row[rules.FIRST_GOAL_MARK :][: len(maze.goal_marks)] = maze.goal_marks
        block = np.zeros((maze.num_cells, rules.MOVE_MASK + 1), dtype=np.int32)
        block[:, :5] = maze.neighbors
        block[:, rules.ROW], block[:, rules.COLUMN] = maze.rows, maze.columns
        moves = maze.neighbors[:, :4] != np.arange(maze.num_cells)[:, None]
        block[:, rules.MOVE_MASK] = moves @ (1 << np.arange(4))
        if maze.goal_marks:
            nearest = np.min([maze.distances_from(goal) for goal in maze.goal_marks], axis=0)
            block[:, rules.MARK_DISTANCE] = nearest
        cells.append(block)
        if maze.num_cells <= MAX_TABLE_CELLS:
            row[rules.TABLE_OFFSET] = num_distances
            distances.append(np.minimum(maze.distances, 65535).astype(np.uint16).ravel())
            num_distances += maze.num_cells**2
        num_cells += maze.num_cells
    return MazeArrays(table, np.concatenate(cells), np.concatenate(distances))


@dataclass(frozen=True)
class SimulatorState:
    """An exact copy of games, random streams and pending settings included."""

    rows: NDArray[np.int32]
    streams: NDArray[np.uint64]
    settings: NDArray[np.int32]
    epsilons: NDArray[np.float64]
    returns: NDArray[np.float64]


class Simulator:
    """Any number of games of one task, stepped in lockstep by compiled kernels.

    A game that ends restarts in the same step; what it ended with stays readable. Game i of a
    batch seeded s is identical to a single game made with `seed=s, first_game=i`, whatever the
    batch size: every random number comes from streams derived from (seed, game index).

    Args:
        task: the rules and settings.
        num_games: games in the batch.
        seed: 0 to 2**64 - 1.
        first_game: the index of the first game of this batch.
        auto_restart: False leaves ended games as they are, still flagged as ended and with rewards
            of 0, until `reset` restarts them.

    Raises:
        ValueError: counts or seeds out of range.

    Attributes (arrays that every step overwrites in place; copy what you keep):
        rows: [num_games, ...] int32, the games as the rule book lays them out.
        positions: [num_games, num_agents] int32, the cell of every agent.
        active: [num_games, num_agents] int32, 0 for captured evaders.
        goals: [num_games, num_goals] int32, the cell of every goal; -1 when gone.
        steps: [num_games] int32, steps taken in the episode.
        maze_index: [num_games] int32, which of `task.mazes` each game plays in.
        rewards: [num_games, num_agents] float32, of the last step.
        returns: [num_games, num_agents] float64, the sum of rewards of the episode so far.
        terminated, truncated: [num_games] bool, of the last step; never both. `ended` is the two
            as one array [2, num_games].
        episode_returns: [num_games, num_agents] float64, of each game's last finished episode.
        episode_lengths: [num_games] int32, likewise.
        final_positions: [num_games, num_agents] int32, where that episode ended.
        epsilon: [num_games, num_agents] float64, the share of random moves of the scripted agent
            in each seat; NaN leaves it to the agent. Write to it to change it at once.
    """

    def __init__(
        self,
        task: Task,
        num_games: int = 1,
        seed: int = 0,
        first_game: int = 0,
        auto_restart: bool = True,
    ) -> None:
        if not isinstance(task, Task):
            raise ValueError(f"task={task!r}; give a Task, such as pursuit.make_task('chase')")
        if num_games < 1:
            raise ValueError(f"num_games={num_games}; give at least 1")
        if first_game < 0:
            raise ValueError(f"first_game={first_game}; games count from 0")
        self.task, self.num_games, self.num_agents = task, num_games, task.num_agents
        self.first_game, self._actions_shape = first_game, (num_games, task.num_agents)
        agents, goals = task.num_agents, task.num_goals
        self.rows: NDArray[np.int32] = np.zeros((num_games, 3 * agents + goals + 2), dtype=np.int32)
        self._final_rows = np.zeros_like(self.rows)
        self._streams = np.zeros((num_games, agents + 2), dtype=np.uint64)
        self._settings = np.full((num_games, rules.NUM_SETTINGS), -1, dtype=np.int32)
        self._settings[:, rules.MIN_START_DISTANCE] = task.min_start_distance
        self._epsilons = np.full((2, num_games, agents), np.nan)
        self._returns = np.zeros((2, num_games, agents))
        self.ended = np.zeros((2, num_games), dtype=bool)
        self.rewards = np.zeros((num_games, agents), dtype=np.float32)
        self._arrays = lay_out(task.mazes)
        needs_search = task.max_cells > MAX_TABLE_CELLS
        self._scratch = np.full((2, task.max_cells if needs_search else 1), -1, dtype=np.int32)
        self._task_fields = tuple(int(x) for x in task.fields_for_kernels())
        self._maze_parts = (self._arrays.mazes, self._arrays.cells, self._arrays.tables)
        flat_streams = self._streams.reshape(-1)
        self._step_front = (self.rows, flat_streams, self._settings, self._epsilons)
        self._step_back: tuple[Any, ...] = (
            self._task_fields,
            task.rewards_for_kernels(),
            *self._maze_parts,
            self._scratch,
            self.rewards,
            self._returns,
            self.ended,
            self._final_rows,
            auto_restart,
        )
        self.positions = self.rows[:, :agents]
        self.active = self.rows[:, agents : 2 * agents]
        self.events = self.rows[:, 2 * agents : 3 * agents]
        self.goals = self.rows[:, 3 * agents : 3 * agents + goals]
        self.steps, self.maze_index = self.rows[:, -2], self.rows[:, -1]
        self.terminated, self.truncated = self.ended
        self.final_positions = self._final_rows[:, :agents]
        self.episode_lengths = self._final_rows[:, -2]
        self.returns, self.episode_returns = self._returns
        self.epsilon = self._epsilons[0]
        self._encoders: dict[str, Encoder] = {}
        self._views: dict[int, GameView] = {}
        self.seed(seed)
        self._placed = False

    def seed(self, seed: int) -> None:
        """Give every random stream of every game the state that belongs to (seed, game index).

        Raises:
            ValueError: not a whole number from 0 to 2**64 - 1.
        """
        if not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**64:
            raise ValueError(f"seed={seed!r}; a seed is a whole number from 0 to 2**64 - 1")
        rules.seed_streams(self._streams, np.uint64(seed), self.first_game)  # type: ignore[arg-type]

    def reset(self, seed: int | None = None, games: ArrayLike | None = None) -> None:
        """Begin new episodes in all games, or in those of the bool mask or index list `games`.

        Raises:
            ValueError: a seed or game out of range, or no placement that the settings allow was
                found.
        """
        chosen = np.zeros(self.num_games, dtype=bool)
        chosen[self._slots(games)] = True
        if seed is not None:
            self.seed(seed)
        outcome = rules.restart_games(
            *self._step_front,
            self._task_fields,
            *self._maze_parts,
            self._scratch,
            self._returns,
            chosen,
        )
        self._check(outcome)
        self.ended[:, chosen] = False
        self._placed = True

    def _slots(self, games: ArrayLike | None) -> NDArray[np.intp]:
        """The indices of `games`, a bool mask or index list; all for None."""
        every = np.arange(self.num_games)
        if games is None:
            return every
        array = np.asarray(games)
        if array.size == 0:
            return every[:0]
        try:
            return np.atleast_1d(every[array])
        except IndexError as error:
            raise ValueError(
                f"games={games}: {error}; give a mask of {self.num_games} bools, or indices"
            ) from None

    def step(self, actions: ArrayLike) -> None:
        """Move every game by one step. Results are in the attributes.

        Args:
            actions: [num_games, num_agents] integers below `task.num_actions`; those of captured
                evaders are ignored (but must be in range).

        Raises:
            ValueError: a wrong shape, dtype or action. Then no game has moved.
        """
        if not self._placed:
            self.reset()
        if not (
            type(actions) is np.ndarray
            and actions.dtype == np.int32
            and actions.flags.c_contiguous
            and actions.shape == self._actions_shape
        ):
            actions = self._checked_actions(actions)
        outcome = rules.step_games(*self._step_front, actions.reshape(-1), *self._step_back)
        if outcome:
            self._check(outcome, actions)

    def _checked_actions(self, actions: ArrayLike) -> NDArray[np.int32]:
        array = np.asarray(actions)
        if array.dtype.kind not in "iu":
            raise ValueError(f"actions of dtype {array.dtype}; give integers")
        if array.shape != (self.num_games, self.num_agents):
            raise ValueError(
                f"actions of shape {array.shape}; give [num_games, num_agents] = "
                f"{(self.num_games, self.num_agents)}"
            )
        return np.ascontiguousarray(np.clip(array, -1, self.task.num_actions), dtype=np.int32)

    def _check(self, outcome: int, actions: NDArray[np.int32] | None = None) -> None:
        if outcome == rules.NO_PLACEMENT:
            raise ValueError(
                f"no start found in {rules.MAX_PLACEMENT_TRIES} tries that keeps chasers and "
                "evaders as far apart as asked; lower min_start_distance, raise "
                "max_start_distance, or take a larger maze"
            )
        if outcome == rules.BAD_ACTION and actions is not None:
            game, seat = np.argwhere((actions < 0) | (actions >= self.task.num_actions))[0]
            raise ValueError(
                f"an action of {self.task.agent_names[seat]} in game {game} is out of range; "
                f"actions are 0 to {self.task.num_actions - 1}"
                + ("" if self.task.stay_action else " (4, stay, needs stay_action=True)")
            )

    # -- settings of the next restart ------------------------------------------------------------

    def configure(
        self,
        games: ArrayLike | None = None,
        *,
        epsilon: ArrayLike | None = None,
        seat: int | str | None = None,
        maze: ArrayLike | None = None,
        num_goals: ArrayLike | None = None,
        goal_radius: ArrayLike | None = None,
        goals_around: str | None = None,
        min_start_distance: ArrayLike | None = None,
        max_start_distance: ArrayLike | None = None,
    ) -> None:
        """Change settings of all games, or of `games`, from their next restart on.

        Args:
            games: a bool mask or index list; all by default.
            epsilon: share of random moves in [0, 1] of the scripted agent in `seat` (all seats by
                default); NaN leaves it to the agent.
            maze: index into `task.mazes`; -1 draws one at every restart.
            num_goals: at most `task.num_goals`; -1 is all of them.
            goal_radius: goals lie within this path distance; -1 is anywhere. Where too few cells
                are that near, the radius grows until the goals fit.
            goals_around: what that radius surrounds: "start" (the first runner's or evader's start)
                or "marks" (the nearest goal mark of the maze).
            min_start_distance, max_start_distance: path distance between every chaser and every
                evader; -1 for no maximum.

        Raises:
            ValueError: a value out of range; nothing is changed then.
        """
        chosen = self._slots(games)
        column = slice(None) if seat is None else self.task.seat(seat)
        if epsilon is not None:
            shares = np.asarray(epsilon, dtype=np.float64)
            if ((shares < 0) | (shares > 1)).any():
                raise ValueError(f"epsilon={epsilon}; a share of random moves lies in [0, 1]")
            if shares.ndim == 1 and seat is None:
                shares = shares[:, None]
            np.broadcast_to(shares, self._epsilons[1, chosen, column].shape)  # or ValueError
        limits = (
            ("maze", maze, rules.NEXT_MAZE, -1, len(self.task.mazes) - 1),
            ("num_goals", num_goals, rules.NEXT_NUM_GOALS, -1, self.task.num_goals),
            ("goal_radius", goal_radius, rules.GOAL_RADIUS, -1, 2**31 - 1),
            ("min_start_distance", min_start_distance, rules.MIN_START_DISTANCE, 1, 2**31 - 1),
            ("max_start_distance", max_start_distance, rules.MAX_START_DISTANCE, -1, 2**31 - 1),
        )
        for name, value, _, least, most in limits:
            if value is not None:
                array = np.asarray(value)
                if array.dtype.kind not in "iu" or array.min() < least or array.max() > most:
                    raise ValueError(f"{name}={value}; whole numbers from {least} to {most}")
                np.broadcast_to(array, chosen.shape)  # or ValueError
        if goals_around not in (None, "start", "marks"):
            raise ValueError(f"goals_around={goals_around!r}; one of start, marks")
        if goals_around == "marks" and not all(maze.goal_marks for maze in self.task.mazes):
            raise ValueError("goals_around='marks', but a maze of this task has no goal mark 'G'")
        if epsilon is not None:
            self._epsilons[1, chosen, column] = shares
        for _, value, setting, _, _ in limits:
            if value is not None:
                self._settings[chosen, setting] = value
        if goals_around is not None:
            self._settings[chosen, rules.GOALS_AROUND_MARKS] = goals_around == "marks"

    def seed_starts(self, games: ArrayLike | None, seeds: ArrayLike) -> None:
        """Make levels repeat: the next start of each game is that of its seed alone.

        Two games of one task that are given the same seed here (and the same settings) begin their
        next episode alike; later episodes follow from there. Other random numbers stay as they
        were.

        Args:
            games: a bool mask or index list; None for all.
            seeds: one whole number from 0 to 2**63 - 1 for all of them, or for each.

        Raises:
            ValueError: a seed out of range, or a wrong number of them.
        """
        chosen = self._slots(games)
        array = np.asarray(seeds)
        if array.dtype.kind not in "iu" or (array.size and not 0 <= array.min() <= array.max()):
            raise ValueError(f"seeds={seeds!r}; whole numbers from 0 to 2**63 - 1")
        each = np.broadcast_to(array, chosen.shape).astype(np.uint64)  # or ValueError
        rules.seed_starts(self._streams, chosen, each)

    # -- copies ----------------------------------------------------------------------------------

    def get_state(self, games: ArrayLike | None = None) -> SimulatorState:
        """Copies of all games, or of those of the index list `games`, exact to the last bit."""
        chosen = self._slots(games)
        return SimulatorState(
            self.rows[chosen],
            self._streams[chosen],
            self._settings[chosen],
            self._epsilons[:, chosen],
            self._returns[:, chosen],
        )

    def set_state(self, state: SimulatorState, games: ArrayLike | None = None) -> None:
        """Put copied games into all slots, or into those of `games`; they go on as they would have.

        Raises:
            ValueError: the number of games, or the task, is another one.
        """
        chosen = self._slots(games)
        if state.rows.shape != (len(chosen), self.rows.shape[1]):
            raise ValueError(
                f"a state of {state.rows.shape[0]} games in rows of {state.rows.shape[1]}; "
                f"{len(chosen)} games in rows of {self.rows.shape[1]} are needed: the same task, "
                "and as many games as slots"
            )
        agents, goals = self.num_agents, self.task.num_goals
        cells = np.c_[state.rows[:, :agents], state.rows[:, 3 * agents : 3 * agents + goals]]
        indices = state.rows[:, -1]
        if (indices >= len(self.task.mazes)).any() or (
            cells >= self._arrays.mazes[indices, rules.CELL_COUNT][:, None]
        ).any():
            raise ValueError("a state of other mazes than these; it must come from the same task")
        self.rows[chosen], self._streams[chosen] = state.rows, state.streams
        self._settings[chosen] = state.settings
        self._epsilons[:, chosen], self._returns[:, chosen] = state.epsilons, state.returns
        self.ended[:, chosen] = False
        self._placed = True

    def place(self, positions: ArrayLike, goals: ArrayLike | None = None) -> None:
        """Put every game at the beginning of an episode with these cells.

        Args:
            positions: [num_games, num_agents] cells (or one row for all games).
            goals: [num_games, num_goals] cells, -1 for an absent goal; needed if there are goals.

        Raises:
            ValueError: a cell out of range, two agents or goals in one cell, or goals left out.
        """
        for name, given in (("positions", positions), ("goals", goals)):
            if given is not None and np.asarray(given).dtype.kind not in "iu":
                raise ValueError(f"{name}={given!r}; give whole numbers, the cells")
        if self.task.num_goals and goals is None:
            raise ValueError(f"goals left out; this task has {self.task.num_goals}")
        self.reset()
        agents = self.num_agents
        placed = np.broadcast_to(np.asarray(positions), (self.num_games, agents))
        if self.task.num_goals and goals is not None:
            shape = (self.num_games, self.task.num_goals)
            placed = np.concatenate([placed, np.broadcast_to(np.asarray(goals), shape)], axis=1)
        sizes = self._arrays.mazes[self.maze_index, rules.CELL_COUNT][:, None]
        least = np.zeros(placed.shape[1], dtype=int)
        least[agents:] = -1
        ordered = np.sort(placed, axis=1)
        if ((placed < least) | (placed >= sizes)).any():
            raise ValueError(
                f"a cell out of range in positions or goals; the largest is {sizes.max() - 1}"
            )
        if ((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)).any():
            raise ValueError("two agents or goals begin in one cell; give each its own")
        self.positions[:] = placed[:, :agents]
        self.goals[:] = placed[:, agents:]

    def __reduce__(self) -> tuple[Any, ...]:
        """For `copy` and `pickle`, which would tear the arrays that share memory apart."""
        last_step = (self._final_rows, self.ended, self.rewards, self._placed)
        batch = (self.task, self.num_games, self.first_game, self._step_back[-1])
        return _copied, (*batch, self.get_state(), *last_step)

    # -- what agents see -------------------------------------------------------------------------

    def encoder(self, encoding: str) -> Encoder:
        """The `Encoder` of `encoding` for this task."""
        if encoding not in self._encoders:
            self._encoders[encoding] = Encoder(self.task, encoding, self._arrays.mazes)
        return self._encoders[encoding]

    def observe(
        self, encoding: str = "one_hot", seat: int | str | None = None, out: Any = None
    ) -> NDArray[Any]:
        """What the agents observe now: a fresh array, or `out`.

        Returns:
            [num_games, num_agents, ...], or [num_games, ...] for one `seat`.
        """
        return self._encode(self.rows, encoding, seat, out)

    def observe_final(
        self,
        encoding: str = "one_hot",
        seat: int | str | None = None,
        games: ArrayLike | None = None,
    ) -> NDArray[Any]:
        """What the agents observed as the last finished episode ended, of all games or `games`."""
        rows = self._final_rows if games is None else self._final_rows[np.asarray(games)]
        return self._encode(rows, encoding, seat, None)

    def _encode(
        self, rows: NDArray[np.int32], encoding: str, seat: int | str | None, out: Any
    ) -> NDArray[Any]:
        encoder = self.encoder(encoding)
        if seat is None:
            return encoder.encode(rows, out=out)
        number = self.task.seat(seat)
        return encoder.encode(
            rows, slice(number, number + 1), None if out is None else out[:, None]
        )[:, 0]

    def view(self, seat: int | str) -> GameView:
        """The games as the policy in `seat` sees them."""
        number = self.task.seat(seat)
        if number not in self._views:
            self._views[number] = GameView(
                self.task,
                number,
                self.rows,
                self._streams,
                self.epsilon,
                *self._maze_parts,
                observe=lambda encoding: self.observe(encoding, number),
            )
        return self._views[number]

    def act(self, policies: Sequence[Policy | None], actions: NDArray[np.int32]) -> None:
        """Write the action of every seat that has a policy into `actions` [games, agents]."""
        if not self._placed:
            self.reset()
        for seat, policy in enumerate(policies):
            if policy is not None:
                actions[:, seat] = policy.act(self.view(seat))


def _copied(
    task: Task,
    num_games: int,
    first_game: int,
    auto_restart: bool,
    state: SimulatorState,
    final_rows: NDArray[np.int32],
    ended: NDArray[np.bool_],
    rewards: NDArray[np.float32],
    placed: bool,
) -> Simulator:
    simulator = Simulator(task, num_games, first_game=first_game, auto_restart=auto_restart)
    simulator.set_state(state)
    simulator._final_rows[:], simulator.ended[:] = final_rows, ended
    simulator.rewards[:], simulator._placed = rewards, placed
    return simulator
