"""Tabular Q-learning over the exact states of a game, with compiled kernels."""

from __future__ import annotations

from math import comb
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
import torch
from numpy.typing import NDArray

from curricula import linear
from pursuit.mazes.maze import Maze
from pursuit.observations.masks import bump_masks
from pursuit.rules import Games, seed_streams
from pursuit.rules.layout import empty_games
from pursuit.simulator.policy import GameView, pairs_of_cells
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from pursuit.validation import check
from scripted_agents.games.episodes import longest_play
from scripted_agents.games.simulator import GameTask, StateView
from train.algorithms.learner import Build
from train.algorithms.q_learning_kernels import choose_actions, learn, number_states
from train.networks.policy import Seat
from train.networks.small_game_policy import SmallGameSeat, check_same_game
from train.settings.algorithms import QLearningSettings
from train.tensors import State

if TYPE_CHECKING:  # slow to import; only training needs them
    from train.environments.simulator_env import SimulatorEnv
    from train.environments.small_game_env import SmallGameTrainingEnv

TableEnv: TypeAlias = "SimulatorEnv | SmallGameTrainingEnv"
TableSeat = Seat | SmallGameSeat

MAX_STATES = 20_000_000
"""Limit of the table's size: with four actions 320 MB, and as much for the visits."""

STEPS_PER_ITERATION = 64
EXPLORATION_SEEDS = 2**63
"""Exploration uses seeds from here on; games have lower ones."""


class StateNumbers:
    """Enumerates the states of a task's games.

    A small game counts as one with all cells 0 but that of the learner, the number of the state.

    Args:
        task: with one maze, or a small game.

    Raises:
        ValueError: several mazes, or more than MAX_STATES states.

    Attributes:
        count: number of states, including unreachable ones.
        goal_sets: number of sets with 0, 1, ... remaining goals, in the order of enumeration.
    """

    def __init__(self, task: Task | GameTask) -> None:
        if isinstance(task, GameTask):
            self.count, self.goal_sets = task.game.num_states, [1]
            # Cells that make the base of all digits 1, so that a state is their sum.
            self.for_kernels = (1 if task.num_agents < 3 else 0, np.ones((3, 1), dtype=np.int64))
            return
        if len(task.mazes) != 1:
            raise ValueError(
                f"q_learning needs a single maze, but this task has {len(task.mazes)}; use one "
                "maze, or an algorithm with a network"
            )
        goals, cells = task.num_goals, task.mazes[0].num_cells
        base = cells + 1 if task.num_agents > 2 else cells
        self.count = base**task.num_agents * sum(comb(cells, g) for g in range(goals + 1))
        if self.count > MAX_STATES:
            raise ValueError(
                f"q_learning needs a table of {self.count:,} states, but the limit is "
                f"{MAX_STATES:,}; use a smaller maze, fewer agents or goals, or an algorithm with "
                "a network"
            )
        self.goal_sets = [comb(cells, k) for k in range(goals + 1)]
        binomials = np.array(
            [[comb(n, k) for k in range(goals + 1)] for n in range(cells + 2)], dtype=np.int64
        )
        binomials[cells + 1] = sum(self.goal_sets)
        self.for_kernels = (cells, binomials)

    def __call__(self, games: Games) -> NDArray[np.int64]:
        """[games] int64, the state number of every game."""
        states = np.empty(len(games.steps), dtype=np.int64)
        self.renumber(games, np.ones(len(states), dtype=bool), states)
        return states

    def renumber(self, games: Games, chosen: NDArray[np.bool_], states: NDArray[np.int64]) -> None:
        """Write the state numbers of the `chosen` games into `states` [games]."""
        number_states(*games, *self.for_kernels, chosen, states)


def check_player(settings: QLearningSettings, seat: TableSeat) -> None:
    """ValueError for a task without a table, a limited view, or unbounded values."""
    if isinstance(seat, SmallGameSeat):
        game = seat.task.game
        if settings.gamma >= 1.0 and game.rewards[:, seat.number].max() > 0.0:
            check(
                longest_play(game) is not None,
                f"gamma={settings.gamma} in {seat.task.name!r}, which can go on forever, makes "
                "values unbounded; use a lower gamma, such as 0.95",
            )
        return
    if seat.task.num_exits or seat.task.options.turns:
        raise ValueError(
            f"q_learning has a table over the cells of agents and goals, without num_exits="
            f"{seat.task.num_exits} drawn exits or move_order={seat.task.move_order!r}; use fixed "
            "exits and simultaneous moves or chasers_first, or an algorithm with a network"
        )
    if seat.task.hides_from(seat.agent):
        raise ValueError(
            f"q_learning has a table over all states, but {seat.agent} has a limited view; use "
            "another algorithm, or an unlimited view"
        )
    StateNumbers(seat.task)
    rewards = seat.task.role_rewards[seat.role]
    if settings.gamma >= 1.0 and (rewards.step > 0.0 or rewards.distance > 0.0):
        raise ValueError(
            f"gamma={settings.gamma} with a positive reward of {seat.agent} at every step makes "
            "values unbounded; use a lower gamma, such as 0.95"
        )


def initial_values(numbers: StateNumbers, actions: int, optimism: float) -> NDArray[np.float64]:
    """[states, actions] float64: `optimism` for every remaining goal; without goals, once."""
    goal_sets = numbers.goal_sets
    if len(goal_sets) == 1:
        return np.full((numbers.count, actions), optimism)
    left = np.repeat(np.arange(len(goal_sets)), goal_sets)
    placements = numbers.count // len(left)
    return np.repeat(np.tile(optimism * left, placements)[:, None], actions, axis=1)


def allowed_in(task: Task, mask_bumps: bool) -> NDArray[np.bool_]:
    """[cells, actions]: the allowed actions in each cell of the one maze."""
    masks = bump_masks(task.mazes[0], task.num_actions)
    return masks if mask_bumps else np.ones_like(masks)


class QTablePolicy:
    """The greedy policy of a table; it follows changes of the table.

    Args:
        task: the task that it was learned in.
        agent: name or role.
        q_values: [states, actions] float64.
        mask_bumps: whether moves into walls are masked.
    """

    def __init__(
        self, task: Task, agent: str, q_values: NDArray[np.float64], mask_bumps: bool = False
    ) -> None:
        self.task, self.agent, self.q_values = task, agent, q_values
        self.numbers, self.allowed = StateNumbers(task), allowed_in(task, mask_bumps)

    def _best(self, games: Games, number: int) -> NDArray[np.int64]:
        """[games] the best allowed action of the agent with index `number`."""
        values = self.q_values[self.numbers(games)]
        return np.where(self.allowed[games.position[:, number]], values, -np.inf).argmax(axis=1)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32: the best action, the lowest of equal ones.

        Raises:
            ValueError: games of another task.
        """
        own, other = self.task, view.task
        same = (
            "num_chasers",
            "num_evaders",
            "num_runners",
            "num_goals",
            "stay_action",
            "num_exits",
        )
        if own.mazes != other.mazes or any(getattr(own, n) != getattr(other, n) for n in same):
            raise ValueError(
                f"a table learned in task {own.name!r} on {own.mazes[0].name} cannot be used in "
                f"task {other.name!r} on {other.mazes[0].name}; use the same maze, agents, goals "
                "and actions"
            )
        if other.hides_from(view.seat):
            raise ValueError(
                f"a table over the states of task {own.name!r} needs full observability, but "
                f"{other.agent_names[view.seat]} has a limited view; use an unlimited view"
            )
        return self._best(view.games, view.seat).astype(np.int32)

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: 1 for the greedy action.

        Raises:
            ValueError: not a duel in this maze with these actions.
        """
        task = self.task
        if not task.is_duel or task.mazes != (maze,) or task.stay_action != stay_action:
            raise ValueError(
                f"a table learned in task {task.name!r} on {task.mazes[0].name} with "
                f"{task.num_actions} actions is not a table over pairs of cells of this maze; use "
                "one of a chaser against an evader in it"
            )
        best = self._best(pairs_of_cells(task, maze, self.agent), task.seat(self.agent))
        return np.eye(task.num_actions)[best].reshape(maze.num_cells, maze.num_cells, -1)


class SmallGameTable:
    """The greedy policy of a table of action values in a small game; it follows changes of them.

    Args:
        seat: the player.
        q_values: [states, actions] float64.
    """

    def __init__(self, seat: SmallGameSeat, q_values: NDArray[np.float64]) -> None:
        self.seat, self.q_values = seat, q_values
        self.task, self.agent = seat.task, seat.agent

    def _best(self, states: Any) -> NDArray[np.int64]:
        """[states] the legal action with the largest value, the lowest of equal ones."""
        return np.where(self.seat.legal[states], self.q_values[states], -np.inf).argmax(axis=1)

    def act(self, view: StateView) -> NDArray[np.int32]:
        """[num_games] int32: the best actions; ValueError in another game."""
        check_same_game(self.task, view.task)
        return self._best(view.state).astype(np.int32)

    def table(self, task: GameTask) -> NDArray[np.float64]:
        """As of `SmallGame.table`: 1 for the greedy action; ValueError in another game."""
        check_same_game(self.task, task)
        return task.flat(self.agent, np.eye(self.seat.num_actions)[self._best(slice(None))])


def policy_of(seat: TableSeat, q_values: NDArray[np.float64]) -> QTablePolicy | SmallGameTable:
    """The greedy policy of a table for a player."""
    if isinstance(seat, SmallGameSeat):
        return SmallGameTable(seat, q_values)
    return QTablePolicy(seat.task, seat.agent, q_values, seat.mask_bumps)


class QLearning:
    """Watkins (1989), with parallel games that share one table.

    Args:
        settings: the hyperparameters.
        env: the training environment; its simulator is stepped directly.
        options: have the seed of the exploration.

    Raises:
        ValueError: the task has too many states for a table.

    Attributes:
        q_values: [states, actions] float64.
        visits: [states, actions] uint32.
    """

    def __init__(self, settings: QLearningSettings, env: TableEnv, options: Build) -> None:
        self.settings, self.env, self.frames = settings, env, 0
        simulator, player = env.simulator, cast("Any", env.player)
        self.numbers = StateNumbers(simulator.task)
        small = isinstance(player, SmallGameSeat)
        self.allowed = player.legal if small else allowed_in(player.task, player.mask_bumps)
        self.q_values = initial_values(self.numbers, player.num_actions, settings.optimism)
        self.visits = np.zeros(self.q_values.shape, dtype=np.uint32)
        self._streams = np.zeros((simulator.num_games, 1), dtype=np.uint64)
        own: Any = np.uint64(EXPLORATION_SEEDS + options.seed)
        seed_streams(self._streams, own, simulator.first_game)
        agents = simulator.task.num_agents
        self._actions = np.zeros((simulator.num_games, agents), dtype=np.int32)
        # Small games as the kernels take them; see `StateNumbers`.
        self._as_games = empty_games(simulator.num_games, agents, 0)
        self._as_games.active[:] = 1
        self._begun = False

    @property
    def _games(self) -> Games:
        """The games as the kernels take them."""
        simulator = self.env.simulator
        if isinstance(simulator, Simulator):
            return simulator.games
        self._as_games.position[:, self.env.seat] = simulator.state
        return self._as_games

    def iterate(self, progress: float) -> dict[str, float]:
        """Play and learn STEPS_PER_ITERATION steps of every game."""
        settings, env = self.settings, self.env
        simulator, seat, actions = env.simulator, env.seat, self._actions
        if not self._begun:
            if not env.resume:
                env.reset_games()
            self._begun = True
        explored = min(progress / max(settings.exploration_share, 1e-9), 1.0)
        epsilon = linear(settings.epsilon_start, settings.epsilon_end, explored)
        error, states = 0.0, self.numbers(self._games)
        done = np.zeros(len(states), dtype=bool)
        bounded = getattr(env, "bounded", False)
        for _ in range(STEPS_PER_ITERATION):
            simulator.act(env.policies, actions)
            choose_actions(
                self.q_values, states, self._games.position, self.allowed, self._streams, epsilon,
                actions, seat,
            )  # fmt: skip
            simulator.step(actions)
            ended = simulator.ended if bounded else simulator.terminated
            size, count = learn(
                self.q_values, self.visits, *self._games, self.numbers.for_kernels,
                self.allowed, states, actions, seat, simulator.rewards, ended,
                simulator.truncated, done, settings.gamma, settings.learning_rate,
                settings.learning_rate_power,
            )  # fmt: skip
            error += size
            if count:
                env.finish(done)
                env.restart(done)
                self.numbers.renumber(self._games, done, states)
        self.frames += STEPS_PER_ITERATION * simulator.num_games
        return {"epsilon": epsilon, "td_error": error / STEPS_PER_ITERATION}

    def policy(self, greedy: bool = True) -> QTablePolicy | SmallGameTable:
        """The greedy policy; otherwise ValueError, as action values are not a distribution."""
        if not greedy:
            raise ValueError("q_learning learns no distribution; use the greedy policy")
        return policy_of(self.env.player, self.q_values)

    def state_dict(self) -> State:
        """The table, the visits, the random streams and the frames."""
        return {
            "q_values": torch.from_numpy(self.q_values),
            "visits": torch.from_numpy(self.visits.view(np.int32)),
            "streams": torch.from_numpy(self._streams.view(np.int64)),
            "frames": self.frames,
        }

    def load_state_dict(self, state: State) -> None:
        """Restore the state; ValueError where the table has another shape."""
        self.q_values[:] = state["q_values"].numpy()
        self.visits[:] = state["visits"].numpy().view(np.uint32)
        self._streams[:] = state["streams"].numpy().view(np.uint64)
        self.frames = state["frames"]

    def close(self) -> None:
        """Nothing to release."""


def load(
    settings: QLearningSettings, seat: TableSeat, state: State, greedy: bool = True
) -> QTablePolicy | SmallGameTable:
    """The policy in a `QLearning.state_dict`; ValueError for a table of another shape."""
    shape = (StateNumbers(seat.task).count, seat.num_actions)
    saved = tuple(state["q_values"].shape)
    check(saved == shape, f"the table has shape {saved} instead of {shape}")
    return policy_of(seat, state["q_values"].numpy())
