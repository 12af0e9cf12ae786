"""The class `Simulator`, which steps batches of games in mazes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit import rules
from pursuit.mazes.maze_arrays import lay_out
from pursuit.memory import check_memory
from pursuit.observations.observations import Encoder
from pursuit.rules import layout
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch
from pursuit.simulator.next_episode import (
    check_waiting,
    fill,
    fill_epsilon,
    game_indices,
    placed_exits,
    setting_limits,
)
from pursuit.simulator.policy import GameArrays, GameView, Policy, play_all
from pursuit.simulator.state import OWN, SimulatorState, check_values
from pursuit.tasks.custom_rewards import step_games_of
from pursuit.tasks.task import Task, checked_task
from pursuit.validation import as_array, one_of, whole_numbers

__all__ = ["Simulator", "SimulatorState"]


class Simulator(GameArrays, Batch[Task]):
    """A batch of games of one task, stepped together by compiled kernels.

    The constructor starts all games. A game restarts in the step that ends its episode, and the
    results of that episode remain available. All random numbers come from streams derived from
    (seed, game index), so game i of a batch with seed s is identical to a single game with
    `seed=s, first_game=i`, for any batch size.

    Args:
        task: the task.
        num_games: number of games in the batch.
        seed: 0 to 2**64 - 1.
        first_game: the index of the first game of this batch.
        auto_restart: if False, ended games keep their state and flags, with rewards of 0, until
            `reset`.

    Raises:
        ValueError: counts or seeds out of range, or not enough memory.

    Attributes (arrays that every step overwrites in place; copy them to keep them):
        games: the arrays of the games under the names that kernels use.
        positions, active, events, goals, steps, maze_index: the same under their public names; see
            `pursuit.simulator.policy.GameArrays`.
        streams: [num_games, ...] uint64, the random streams.
        rewards: [num_games, num_agents] float32, of the last step.
        returns: [num_games, num_agents] float64, the sum of rewards of the episode so far.
        collected: [num_games, num_agents] float64, goals collected in it; shared ones by parts.
        terminated, truncated: [num_games] bool, of the last step; never both.
        episode_returns: [num_games, num_agents] float64, of each game's last finished episode.
        episode_lengths: [num_games] int32, likewise.
        final_positions: [num_games, num_agents] int32, the final cells of that episode.
        epsilon: [num_games, num_agents] float64, the probability of random moves of each scripted
            agent; NaN uses the epsilon of the agent. Writing to it has an immediate effect and
            lasts until `configure` sets another value for the next episode. It can be set to a
            number, to [num_games] (as in `configure`) or to [num_games, num_agents].
        next_epsilon: the same from the next episode on; -1 for no change.
        exits: [num_games, exits] int32, the cells of exits; -1 for absent ones.
        slip, next_slip: [num_games, num_agents] float64, the probabilities of slips in this episode
            and from the next one on (-1 for no change); None in tasks without slips.
        last_seed: the last seed of all streams; None after `set_state`, and after seeding only
            some games.
    """

    def __init__(
        self,
        task: Task,
        num_games: int = 1,
        seed: int = 0,
        first_game: int = 0,
        auto_restart: bool = True,
    ) -> None:
        super().__init__(checked_task(task), num_games, seed, first_game, auto_restart)
        num_games, self.num_agents = self.num_games, task.num_agents
        slips = task.options.slips
        sizes = (task.num_agents, task.num_goals, task.most_exits, slips)
        one = layout.allocate(1, *sizes)
        bytes_of_game = sum(array.nbytes for array in one)
        check_memory(f"num_games={num_games}", num_games * bytes_of_game, "take fewer games")
        self._actions_shape = (num_games, task.num_agents)
        memory = layout.allocate(num_games, *sizes)
        self.slip: NDArray[np.float64] | None = None
        self.next_slip: NDArray[np.float64] | None = None
        if slips:
            memory.reals[:, layout.SLIP] = task.slips
            reals = memory.reals
            self.slip, self.next_slip = reals[:, layout.SLIP], reals[:, layout.NEXT_SLIP]
        self._arrays = memory
        self._mazes = lay_out(task.mazes)
        # The arguments of all kernels: the batch, the rules, the mazes, scratch memory.
        self._kernel_arrays = (
            *memory,
            task.numbers_for_kernels(),
            task.rewards_for_kernels(),
            *self._mazes,
            layout.scratch_for(task.max_cells, task.num_agents, task.num_goals),
        )
        self._step_games = step_games_of(task)
        self.games: layout.Games = layout.named_views(layout.games_of, memory)
        self._outcome: layout.Outcome = layout.named_views(layout.outcome_of, memory)
        self._coming: layout.NextEpisode = layout.named_views(layout.next_episode_of, memory)
        self.streams: NDArray[np.uint64] = memory.streams
        self._epsilon: NDArray[np.float64] = memory.reals[:, layout.EPSILON]
        self.next_epsilon: NDArray[np.float64] = self._coming.epsilon
        outcome = self._outcome
        self.rewards: NDArray[np.float32] = outcome.rewards
        self.returns: NDArray[np.float64] = outcome.returns
        self.collected: NDArray[np.float64] = outcome.collected
        self.terminated: NDArray[np.bool_] = outcome.terminated
        self.truncated: NDArray[np.bool_] = outcome.truncated
        self.episode_returns: NDArray[np.float64] = outcome.episode_returns
        self.final_positions: NDArray[np.int32] = outcome.final.position
        self.episode_lengths: NDArray[np.int32] = outcome.final.steps
        self._encoders: dict[tuple[str, str], Encoder] = {}
        self._views: dict[int, GameView] = {}
        self._coming.min_start_distance[:] = task.min_start_distance
        self.reset(seed)

    @property
    def epsilon(self) -> NDArray[np.float64]:
        """See the attributes; a live array."""
        return self._epsilon

    @epsilon.setter
    def epsilon(self, shares: ArrayLike) -> None:
        fill_epsilon(self._epsilon, shares)

    def _start(self, chosen: NDArray[np.bool_]) -> None:
        kernel = rules.step_games_of(self.task.teams, self.task.options)
        rules.start_games(kernel, self._kernel_arrays, chosen)

    def step(self, actions: ArrayLike) -> None:
        """Step all games. Results are in the attributes.

        Args:
            actions: [num_games, num_agents] integers below `task.num_actions`; those of captured
                evaders are ignored, but must be in range.

        Raises:
            ValueError: a wrong shape, dtype or action. Then no game moves.
        """
        if not (
            type(actions) is np.ndarray
            and actions.dtype == np.int32
            and actions.flags.c_contiguous
            and actions.shape == self._actions_shape
        ):
            actions = self._checked_actions(actions)
        mode = layout.RESTART if self.auto_restart else layout.NO_RESTART
        if self._step_games(*self._kernel_arrays, actions, mode) != layout.OK:
            stay = self.task.num_moves
            game, seat = np.argwhere((actions < 0) | (actions >= self.task.num_actions))[0]
            raise ValueError(
                f"an action of {self.task.agent_names[seat]} in game {game} is out of range; "
                f"actions are 0 to {self.task.num_actions - 1}"
                + ("" if self.task.stay_action else f" ({stay}, stay, needs stay_action=True)")
            )

    def _checked_actions(self, actions: ArrayLike) -> NDArray[np.int32]:
        array = as_array("actions", actions, "iu", "give integers")
        if array.shape != self._actions_shape:
            shape = self._actions_shape
            raise ValueError(f"actions of shape {array.shape}; [num_games, num_agents] is {shape}")
        signed = array.astype(np.int64, copy=False)  # NumPy 2.0 refuses to clip uint8 at -1
        return np.ascontiguousarray(np.clip(signed, -1, self.task.num_actions), dtype=np.int32)

    # -- the next episode ------------------------------------------------------------------------

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
        slip: ArrayLike | None = None,
    ) -> None:
        """Change settings of all games, or of `games`, from their next restart on.

        Args:
            games: a bool mask or index list; default: all.
            epsilon: probability of random moves, in [0, 1], of the scripted agent `seat` (default:
                all agents); NaN uses the epsilon of the agent. A number, [games], or without `seat`
                [games, agents].
            maze: index in `task.mazes`; -1 draws a maze at every restart.
            num_goals: at most `task.num_goals`; -1 is all of them.
            goal_radius: goals are placed within this path distance; -1 is no limit. The radius
                grows until it contains enough cells for the goals.
            goals_around: centre of that radius: "start" (the start of the first runner or evader)
                or "marks" (the nearest goal mark of the maze).
            min_start_distance, max_start_distance: path distance between every chaser and every
                evader; -1 for no maximum. The distance of unconnected cells is infinite.
            slip: the probability of a slip of the agent `seat` (default: all agents), in tasks with
                `slip` above 0; a number, [games], or without `seat` [games, agents].

        Raises:
            ValueError: a value out of range, or distances that no placement satisfies. Nothing is
                changed then.
        """
        task, pending, chosen = self.task, self._coming, game_indices(games, self.num_games)
        seats = slice(None) if seat is None else task.seat(seat)
        changed: dict[str, Array] = {}
        if epsilon is not None:
            changed["epsilon"] = pending.epsilon[chosen]
            fill_epsilon(changed["epsilon"][:, seats], epsilon)
        if slip is not None:
            if self.next_slip is None:
                raise ValueError(f"slip={slip!r}; this task has no slips: give Task a slip above 0")
            changed["slip"] = self.next_slip[chosen]
            fill_epsilon(changed["slip"][:, seats], slip, "slip")
        numbers = {
            "maze": maze,
            "num_goals": num_goals,
            "goal_radius": goal_radius,
            "min_start_distance": min_start_distance,
            "max_start_distance": max_start_distance,
        }
        if goals_around is not None:
            one_of("goals_around", goals_around, ("start", "marks"))
            numbers["goals_around_marks"] = int(goals_around == "marks")
        limits = setting_limits(task)
        for name, value in numbers.items():
            if value is not None:
                changed[name] = np.empty(len(chosen), dtype=np.int32)
                fill(name, changed[name], whole_numbers(name, value, *limits[name]))
        slips = changed.pop("slip", None)
        if changed.keys() - {"epsilon", "goal_radius"}:
            waiting = {name: array[chosen] for name, array in pending._asdict().items()}
            check_waiting(task, layout.NextEpisode(**waiting | changed))
        for name, values in changed.items():
            getattr(pending, name)[chosen] = values
        if slips is not None and self.next_slip is not None:
            self.next_slip[chosen] = slips

    def _live(self) -> dict[str, Array]:
        """The live arrays that make up the state."""
        waiting = {f"next_{name}": array for name, array in self._coming._asdict().items()}
        exits = {"exits": self.exits} if self.task.most_exits else {}
        own = {name: getattr(self, name) for name in OWN}
        slips = {} if self.slip is None else {"slip": self.slip, "next_slip": self.next_slip}
        return {**own, **exits, **slips, "epsilon": self._epsilon, **waiting}

    def _check_values(self, state: SimulatorState) -> None:
        check_values(state, self.task)

    def place(
        self,
        positions: ArrayLike,
        goals: ArrayLike | None = None,
        maze: ArrayLike | None = None,
        seed: int | None = None,
        games: ArrayLike | None = None,
        exits: ArrayLike | None = None,
    ) -> None:
        """Start an episode with these cells; limits on start distances are ignored.

        Args:
            positions: [num_games, num_agents] cells in the order of `task.agent_names` (chasers,
                evaders, runners), or one row for all games.
            goals: [num_games, num_goals] cells, -1 for an absent goal; required if there are goals.
            maze: index in `task.mazes`, for all games or for each; required if there are several
                and `configure` has set none.
            seed, games: as in `reset`; cells are given for all games.
            exits: [num_games, num_exits] cells; required if the task draws them, else left out.

        Raises:
            ValueError: a cell out of range, two agents or goals in one cell, an evader or a goal on
                an exit, or missing goals, exits or maze. Nothing is changed then.
        """
        task, count = self.task, self.num_games
        agents = np.empty((count, task.num_agents), dtype=np.int32)
        wanted = np.empty((count, task.num_goals), dtype=np.int32)
        mazes = self._coming.maze.copy() if len(task.mazes) > 1 else np.zeros(count, dtype=np.int32)
        if maze is not None:
            fill("maze", mazes, whole_numbers("maze", maze, 0, len(task.mazes) - 1))
        if (mazes < 0).any():
            raise ValueError(
                f"maze is missing; this task has {len(task.mazes)}: give the index of one, or one "
                "per game"
            )
        fill("positions", agents, whole_numbers("positions", positions, 0, task.max_cells - 1))
        if goals is None and task.num_goals:
            raise ValueError(f"goals are missing; give cells for {task.num_goals} goals")
        if goals is not None:
            cells = whole_numbers("goals", goals, -1, task.max_cells - 1)
            if cells.size and not task.num_goals:
                raise ValueError(f"goals={goals!r}; this task has no goals, leave them out")
            fill("goals", wanted, cells)
        sizes = np.array([each.num_cells for each in task.mazes])[mazes][:, None]
        both = np.concatenate([agents, wanted], axis=1)
        if (both >= sizes).any():
            game, place = np.argwhere(both >= sizes)[0]
            raise ValueError(
                f"cell {both[game, place]} in positions or goals; the cells of maze "
                f"{task.mazes[mazes[game]].name} are 0 to {sizes[game, 0] - 1}"
            )
        ordered = np.sort(both, axis=1)
        if ((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)).any():
            raise ValueError("two agents or goals start in the same cell; give different cells")
        places = placed_exits(task, exits, mazes, agents, wanted)
        self.reset(seed, games)
        chosen = game_indices(games, self.num_games)
        live = (self.positions, self.goals, self.maze_index, self.exits)
        for array, start in zip(live, (agents, wanted, mazes, places), strict=True):
            array[chosen] = start[chosen]

    # -- observations ----------------------------------------------------------------------------

    def encoder(self, encoding: str, dtype: str | None = None) -> Encoder:
        """The `Encoder` of `encoding` for this task, in its default dtype or the given one."""
        key = encoding, str(dtype)
        if not isinstance(encoding, str) or key not in self._encoders:
            self._encoders[key] = Encoder(self.task, encoding, dtype)
        return self._encoders[key]

    def observe(
        self,
        encoding: str = "one_hot",
        seat: int | str | None = None,
        out: Any = None,
        dtype: str | None = None,
    ) -> Array:
        """The current observations: a new array, or `out`.

        The shape is [num_games, num_agents, ...], or [num_games, ...] for one `seat`. `dtype` is
        that of the `Encoder`.
        """
        return self._encode(self.games, encoding, seat, dtype, out)

    def observe_final(
        self,
        encoding: str = "one_hot",
        seat: int | str | None = None,
        games: ArrayLike | None = None,
        dtype: str | None = None,
    ) -> Array:
        """The observations at the end of the last episodes, of all games or of `games`."""
        final = self._outcome.final
        if games is not None:
            chosen = game_indices(games, self.num_games)
            final = layout.copied_games(final, chosen)
        return self._encode(final, encoding, seat, dtype)

    def _encode(
        self,
        games: layout.Games,
        encoding: str,
        seat: int | str | None,
        dtype: str | None = None,
        out: Any = None,
    ) -> Array:
        encoder = self.encoder(encoding, dtype)
        if seat is None:
            return encoder.encode(games, out=out)
        number = self.task.seat(seat)
        one = out[:, None] if isinstance(out, np.ndarray) and out.ndim else out
        return encoder.encode(games, slice(number, number + 1), one)[:, 0]

    def view(self, seat: int | str) -> GameView:
        """The view of the games for the policy of agent `seat`."""
        number = self.task.seat(seat)
        if number not in self._views:
            self._views[number] = GameView(
                self.task, number, self.games, self.streams, self._epsilon, self._mazes,
                observe=lambda encoding, dtype=None: self._encode(
                    self.games, encoding, number, dtype
                ),
            )  # fmt: skip
        return self._views[number]

    def act(self, policies: Sequence[Policy | None], actions: NDArray[np.int32]) -> None:
        """Write the actions of all agents with a policy into `actions` [games, agents].

        Raises:
            ValueError: a wrong shape or number of policies, or a policy of another role.
        """
        play_all(policies, actions, self._actions_shape, self.view)
