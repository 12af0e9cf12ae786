"""Tasks as small games: the states and transitions of the joint solver, state by state.

In `game_of_task` every agent is a player, in `game_of_sides` each of two sides is one.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from itertools import compress, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.memory import check_memory
from pursuit.rendering.marks import AgentMark
from pursuit.rendering.rendering import Scene
from pursuit.rules.layout import Games
from pursuit.tasks.task import ACTIONS, Task, checked_task
from scripted_agents.exact.joint.layout import places_within
from scripted_agents.exact.joint.opponents import lay_out_others
from scripted_agents.exact.joint.states import joint_states_of
from scripted_agents.exact.joint.sweeps import Problem, Quantity, filled_store
from scripted_agents.exact.limits import (
    MAX_STORE_BYTES,
    MAX_TASK_STATES,
    REMEDY,
    check_joint_states,
)
from scripted_agents.games.game import State
from scripted_agents.games.small_game import SmallGame

CAPTURED = -1
"""The cell of a captured evader in a state."""


def states_of_games(games: Games) -> list[tuple[tuple[int, ...], ...]]:
    """The states of `game_of_task` that games are in.

    Each has the cell of every agent, -1 for captured and escaped evaders, the cells of the goals
    that are left, in order, and in games with exits those of the exits.
    """
    cells = np.where(games.active != 0, games.position, CAPTURED).tolist()
    parts = [games.goal, games.exit] if games.exit.shape[1] else [games.goal]
    places = [[tuple(sorted({*row} - {-1})) for row in part.tolist()] for part in parts]
    return [(tuple(row), *rest) for row, *rest in zip(cells, *places, strict=True)]


def game_of_task(task: Task, most_states: int = MAX_TASK_STATES) -> SmallGame:
    """A task in one maze as a small game without a limit on steps; every agent is a player.

    A state is (cells of the agents, cells of the goals), with exits (..., cells of the exits); see
    `states_of_games`. Of actions that lead to the same cell only the first is listed.

    Raises:
        ValueError: several mazes, user-defined rewards, slips, turns, too many states, or too
            little memory.
    """
    task = _with_coefficients(task)
    if task.options.slips or task.options.turns:
        raise ValueError(
            f"task {task.name!r} with slip={task.slip!r}, move_order={task.move_order!r}: here a "
            "small game has neither; use game_of_sides, or solve_joint and joint_nash_conv"
        )
    check_joint_states(task, most_states, each=1000)
    return _enumerated(task)


def _with_coefficients(task: Task) -> Task:
    """The task; ValueError unless its rewards are coefficients."""
    if checked_task(task).reward_function is not None:
        raise ValueError(
            f"task {task.name!r} has a custom reward function; give rewards by coefficients"
        )
    return task


def _enumerated(task: Task) -> SmallGame:
    """The game of a task without slips; in turns the move of one side is a step."""
    from scipy.sparse import csr_array  # slow to import

    joints, most = task.num_actions**task.num_agents, np.iinfo(np.int16).max
    if joints > most:  # their numbers in a `Store`
        raise ValueError(
            f"task {task.name!r}: {task.num_agents} agents have {joints:,} joint actions; at most "
            f"{most:,} are possible: give fewer agents"
        )
    joint = joint_states_of(task)
    agents, nothing = task.num_agents, [0] * task.num_agents
    rewards = [Quantity(row, nothing) for row in np.eye(agents, dtype=np.int64).tolist()]
    problem = Problem(
        joint, tuple(range(agents)), lay_out_others(joint, {}), tuple(rewards), moves_first=False
    )
    store = filled_store(problem)
    counts = store.shape[:, 0].astype(np.int64)
    kept = np.flatnonzero(counts)
    state = np.repeat(kept, counts[kept])
    begins = np.concatenate([[0], np.cumsum(counts[kept])])
    within = places_within(counts[kept])
    played = store.joints[store.edges[state] + within].astype(np.int64)
    given = store.edges[state] + within * agents
    after = store.following[store.pairs[state] + within]
    renumbered = np.full(joint.count, -1)
    renumbered[kept] = np.arange(len(kept))
    goes_on = np.flatnonzero(after >= 0)
    following = csr_array(
        (np.ones(len(goes_on)), (goes_on, renumbered[after[goes_on]])),
        shape=(len(state), len(kept)),
    )
    names: list[State] = []
    for _, games, real in joint.chunks():
        places = states_of_games(games)
        if task.options.turns:
            places = [(*row, half) for row, half in zip(places, games.steps.tolist(), strict=True)]
        names += compress(places, real)
    actions, choices = _actions(task, played, begins)
    start = np.zeros(joint.count)
    for numbers in joint.starts():
        weights = joint.weights(numbers)
        start[numbers] = 1.0 if weights is None else weights
    return SmallGame(
        task.agent_names,
        names,
        {name: number for number, name in enumerate(names)},
        actions,
        begins,
        choices,
        np.stack([store.sides[given + agent] for agent in range(agents)], axis=1),
        following,
        start[kept] / start.sum(),
        task,
    )


def _actions(
    task: Task, played: NDArray[np.int64], begins: NDArray[np.int64]
) -> tuple[list[list[Sequence[Hashable]]], NDArray[np.int32]]:
    """The legal actions of every player and state, and the index of each player's action."""
    agents, number = task.num_agents, task.num_actions
    single = np.stack([played // number ** (agents - 1 - at) % number for at in range(agents)], 1)
    actions: list[list[Sequence[Hashable]]] = [[] for _ in range(agents)]
    choices = np.empty_like(single, dtype=np.int32)
    for first, last in zip(begins[:-1].tolist(), begins[1:].tolist(), strict=True):
        for agent in range(agents):
            legal, index = np.unique(single[first:last, agent], return_inverse=True)
            actions[agent].append(tuple(legal.tolist()))
            choices[first:last, agent] = index
    return actions, choices


# -- two sides -------------------------------------------------------------------------------------


def game_of_sides(task: Task, most_states: int = MAX_TASK_STATES) -> SmallGame:
    """A task in one maze as a zero-sum small game of two players without a limit on steps.

    Of a task with two roles, each role is a player, which chooses the moves of all its agents as
    one tuple. Of a task with two agents of one role, each agent is a player. The payoff of the
    first player is half of: the mean reward of its agents minus the mean reward of the others. In
    `zero_sum` chases this is minus the number of steps, so NashConv is that of the task (in turns,
    of the rounds that both sides play).

    Actions of agents are the words of `pursuit.tasks.task.ACTIONS`, in graphs numbers. Slips are
    part of the transitions. In a game with turns the move of one side is a step, and is discounted
    as such; a state ends with 0 if the chasers are to move, else 1, and the only action of a side
    that waits is None.

    Raises:
        ValueError: no two sides, several mazes, limited views, user-defined rewards, too many
            states, or too little memory.
    """
    task = _with_coefficients(task)
    roles = list(dict.fromkeys(task.seat_roles))
    if len(roles) != 2 and task.num_agents != 2:
        raise ValueError(
            f"task {task.name!r} has agents {', '.join(task.agent_names)}; give agents of two "
            "roles, or two agents"
        )
    check_joint_states(task, most_states, each=1000)
    hidden = [name for name in task.agent_names if task.hides_from(name)]
    if hidden:
        raise ValueError(
            f"task {task.name!r}: the view of {hidden[0]} is limited, but players of a small game "
            "see everything; leave out view_radius, line_of_sight and unknown_maze"
        )
    names = roles if len(roles) == 2 else list(task.agent_names)
    first = task.seat_roles.count(roles[0]) if len(roles) == 2 else 1
    chances = task.slips
    game = with_slips(_enumerated(replace(task, slip=0.0)), chances, task.mazes[0].neighbors)
    return _merged(game, (names[0], names[1]), first, task)


def with_slips(
    game: SmallGame, chances: Sequence[float], neighbors: NDArray[np.integer]
) -> SmallGame:
    """A game of a task in which moves slip: with its chance, that of an agent is replaced by a
    uniformly random one of those that change the cell.

    Args:
        game: of every agent as a player, without slips.
        chances: of a slip, by agent.
        neighbors: [cells, actions] of the maze.

    Raises:
        ValueError: too little memory.
    """
    from scipy.sparse import csr_array  # slow to import

    sizes = np.stack([np.diff(game.offsets(agent)) for agent in range(len(game.players))], axis=1)
    if not any(chances):
        return game
    entries = (sizes.prod(axis=1) * sizes[:, np.array(chances) > 0.0].prod(axis=1)).sum()
    what = f"a game of {game.num_states:,} states with slips: {entries:,} outcomes"
    check_memory(what, 40 * int(entries), REMEDY, MAX_STORE_BYTES)
    joints = np.arange(len(game.owners))
    for agent, chance in enumerate(chances):
        if chance == 0.0:
            continue
        offsets = game.offsets(agent)
        cells = np.array([state[0][agent] for state in game.states])  # type: ignore[index]
        actions = np.concatenate([np.asarray(row) for row in game.actions[agent]])
        owner = np.repeat(np.arange(game.num_states), sizes[:, agent])
        moves = (neighbors[cells[owner], actions] != cells[owner]) & (cells[owner] >= 0)
        many = np.add.reduceat(moves, offsets[:-1])
        slips = many[game.owners] > 0  # agents that have left, or wait, have no moves
        repeated = sizes[game.owners[slips], agent]
        options = np.repeat(joints[slips], repeated)
        state, place = game.owners[options], places_within(repeated)
        stride = sizes[state, agent + 1 :].prod(axis=1)
        target = options + (place - game.choices[options, agent]) * stride
        weight = chance * moves[offsets[state] + place] / many[state]
        rows, columns = np.concatenate([joints, options]), np.concatenate([joints, target])
        kept = np.where(slips, 1.0 - chance, 1.0)
        mix = csr_array((np.concatenate([kept, weight]), (rows, columns)))
        game = replace(game, following=mix @ game.following, rewards=mix @ game.rewards)
    return game


def _merged(game: SmallGame, names: tuple[str, str], first: int, task: Task) -> SmallGame:
    """The zero-sum game of the first agents as one player and of all others as the other."""
    words: Sequence[Hashable] = ACTIONS if task.mazes[0].is_grid else range(task.num_actions)
    numbers: Any = game.actions
    own = [[tuple(words[action] for action in row) for row in rows] for rows in numbers]
    sides = range(first), range(first, len(game.players))
    sizes = np.stack([np.diff(game.offsets(agent)) for agent in range(len(game.players))], axis=1)
    actions: list[list[Sequence[Hashable]]] = []
    choices = np.zeros((len(game.choices), 2), dtype=np.int32)
    for player, side in enumerate(sides):
        rows = [*zip(*(own[agent] for agent in side), strict=True)]
        actions.append([row[0] if len(side) == 1 else tuple(product(*row)) for row in rows])
        if task.options.turns:
            waits = [state[-1] != player for state in game.states]  # type: ignore[index]
            actions[player] = [
                (None,) if wait else row for wait, row in zip(waits, actions[player], strict=True)
            ]
        for agent in side:
            choices[:, player] *= sizes[game.owners, agent]
            choices[:, player] += game.choices[:, agent]
    lead = (game.rewards[:, :first].mean(axis=1) - game.rewards[:, first:].mean(axis=1)) / 2.0
    rewards, source = np.stack([lead, -lead], axis=1), StatesOfSides(task)
    changed: Any = {"actions": actions, "choices": choices, "rewards": rewards}
    return replace(game, players=names, task=None, source=source, **changed)


@dataclass(frozen=True)
class StatesOfSides:
    """What networks and readers see of the states of `game_of_sides`.

    Attributes:
        task: the task.
    """

    task: Task

    def _parts(self, state: State) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...], int]:
        """The cells of the agents, the goals and the exits, and which side moves (-1: both)."""
        cells, goals, *rest = state
        exits = rest[0] if self.task.most_exits else ()
        return cells, goals, exits, rest[-1] if self.task.options.turns else -1

    def observe(self, state: State, player: int) -> NDArray[np.float32]:
        """[agents * cells + ...] float32, 0 or 1: by agent its cell, the cells of goals and exits,
        and in turns whether the player is to move; equal for both players but for that."""
        cells, goals, exits, moves = self._parts(state)
        rows: list[Sequence[int]] = [[cell] for cell in cells]
        rows += [goals] * (self.task.num_goals > 0) + [exits] * (self.task.most_exits > 0)
        seen = np.zeros((len(rows), self.task.max_cells), dtype=np.float32)
        for row, places in zip(seen, rows, strict=True):
            row[[place for place in places if place >= 0]] = 1.0
        turn = [moves == player] if self.task.options.turns else []
        return np.append(seen, np.array(turn, dtype=np.float32))

    def draw(self, state: State) -> str:
        """The maze as text, without agents that have left the game."""
        cells, goals, exits, moves = self._parts(state)
        names = zip(self.task.agent_names, cells, strict=True)
        agents = tuple(AgentMark(name, cell) for name, cell in names if cell >= 0)
        moving = ("", "chasers to move", "others to move")[moves + 1]
        scene = Scene(self.task.mazes[0], agents, goals, 0, 0, moving, exits)
        return scene.text().replace(f"{scene.footer}  ", "").replace(f"{scene.footer}\n", "")
