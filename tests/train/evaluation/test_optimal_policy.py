"""The optimal policy as a target of imitation: of every kind of game, or why there is none."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from option_tasks import ONE_WAY, TORUS
from random_mazes import connected_maze
from small_games import Nim, RandomGame, random_tables

from pursuit.mazes.maze import Maze, load_maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import action_masks, bump_masks
from pursuit.simulator.policy import pairs_of_cells
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    SearchingChaser,
    UniformAgent,
    best_response,
    evaluate_exactly,
    solve_joint,
)
from scripted_agents.exact.tours.runner import first_moves
from scripted_agents.games import enumerate_game, returns_of
from scripted_agents.games.agents import TableAgent
from scripted_agents.games.simulator import GameTask
from train.evaluation.contest import GameContest
from train.evaluation.optimal_policy import OptimalPolicy
from train.evaluation.small_game_contest import SmallGameContest
from train.runs.worlds import task_world_of
from train.settings.task import ReacherSettings, SmallGameSettings, TaskSettings

OPEN = Maze.from_text("+-+-+-+\n|     |\n+ + + +\n|     |\n+ + + +\n|     |\n+-+-+-+")


SETTINGS = {"reacher": ReacherSettings, "game": SmallGameSettings}


def world_of(team: bool = False, **settings: Any) -> Any:
    return task_world_of(SETTINGS.get(settings["task"], TaskSettings)(**settings), team)


# -- tours -----------------------------------------------------------------------------------------


def tour_by_order(maze: Maze, start: int, goals: list[int]) -> int:
    """The length of the shortest tour, by all orders of the goals."""
    lengths = []
    for order in itertools.permutations(goals):
        stops = (start, *order)
        lengths.append(sum(int(maze.distances[pair]) for pair in itertools.pairwise(stops)))
    return min(lengths)


@pytest.mark.parametrize("num_goals", [1, 2, 4])
def test_a_runner_begins_all_shortest_tours(num_goals: int) -> None:
    """In several random mazes at once, on a torus and on a directed graph; with goals left."""
    drawn = tuple(connected_maze(seed, 3, 4) for seed in range(5))
    for mazes in (drawn, (OPEN,), (ONE_WAY,), (TORUS,)):
        task = Task(maze=mazes, num_runners=1, num_goals=num_goals)
        games = Simulator(task, 60, seed=3)
        games.games.goal[::3, num_goals // 2 :] = -1  # some are collected
        found, ties = first_moves(task, games.games, 0), 0
        for game, row in enumerate(found):
            maze, own = mazes[games.maze_index[game]], int(games.positions[game, 0])
            goals = [goal for goal in games.goals[game].tolist() if goal >= 0]
            if not goals:
                assert not row.any()
                continue
            best, expected = tour_by_order(maze, own, goals), []
            for after in maze.neighbors[own, : task.num_actions].tolist():
                left = [goal for goal in goals if goal != after]
                rest = tour_by_order(maze, after, left) if left else 0
                expected.append(after != own and 1 + rest == best)
            assert row.tolist() == expected
            ties += sum(expected) > 1
        assert ties > 0 or mazes == (ONE_WAY,)


@pytest.mark.parametrize("maze", ["5x5-open", "suite:5x5-test/0-3"])
def test_playing_all_shortest_tours_alike_is_optimal(maze: str) -> None:
    world = world_of(task="maze", maze=maze, num_goals=3, mask_bumps=True)
    policy, contest = world.optimal_policy(), world.contest(200)
    rows = policy.distribution(world.task, contest.starts().games, 0)
    assert ((rows > 0).sum(axis=1) > 1).any()
    np.testing.assert_array_equal(contest.play(policy)[0], contest.optimal_lengths())


def test_a_maze_without_distances_is_refused() -> None:
    large = Maze(*(np.ones(shape, dtype=bool) for shape in ((70, 70), (69, 70), (70, 69))))
    with pytest.raises(ValueError, match="a maze of 4900 cells; shortest tours are listed"):
        GameContest(Task(maze=large, num_runners=1, num_goals=2), "runner", {}).optimal_policy()


# -- duels -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("role", ["chaser", "evader"])
@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize("stay", [False, True])
def test_duels_have_all_optimal_actions_of_the_joint_solver(
    role: Any, order: Any, stay: bool
) -> None:
    other = {"chaser": "evader", "evader": "chaser"}[role]
    opponents: Any = {"evader": AStarEvader(0.3), "chaser": AStarChaser(0.4)}
    for maze in (*(connected_maze(seed, 3, 4) for seed in range(4)), TORUS, ONE_WAY):
        task = make_task("chase", maze=maze, move_order=order, stay_action=stay, max_steps=30)
        contest = GameContest(task, role, opponents)
        assert contest.exact_reference.kind == "duel"
        solved = solve_joint(task, role, {other: opponents[other]}, 30)
        joint = OptimalPolicy(solved.optimal_actions, task, contest.seats, mask_bumps=False)
        games = pairs_of_cells(task, maze, role)
        rows, expected = (
            each.distribution(task, games, contest.seat)  # type: ignore[attr-defined]
            for each in (contest.optimal_policy(), joint)
        )
        apart = games.position[:, 0] != games.position[:, 1]
        np.testing.assert_array_equal(rows[apart], expected[apart])


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_no_other_action_is_as_good_and_all_of_them_alike_are_optimal(role: Any) -> None:
    """An action is played first, and whenever the game comes back to its state."""
    maze = load_maze("3x3-tree")
    task = make_task("chase", maze=maze, stay_action=True, max_steps=100_000)
    others: Any = {"evader": AStarEvader(0.5), "chaser": UniformAgent()}
    contest = GameContest(task, role, others)
    policy: Any = contest.optimal_policy()
    size, opponent = maze.num_cells, contest.opponent_table()
    rows = policy.distribution(task, pairs_of_cells(task, maze, role), contest.seat)
    table = rows.reshape(size, size, 5)

    def values(own: Any) -> Any:
        pair = (own, opponent) if role == "chaser" else (opponent, own)
        found = evaluate_exactly(maze, *pair, horizon=None).values
        return found if role == "chaser" else found.T

    best = best_response(role, maze, opponent, None).values
    np.testing.assert_allclose(values(table), best if role == "chaser" else best.T, rtol=1e-7)
    worst = 0
    for own, other in itertools.permutations(range(size), 2):
        for action in range(5):
            changed = table.copy()
            changed[own, other] = np.eye(5)[action]
            gap = values(changed)[own, other] / values(table)[own, other] - 1.0
            gap = gap if role == "chaser" else -gap
            if table[own, other, action] > 0:
                assert abs(gap) < 1e-7
            else:
                assert gap > 1e-4
                worst += 1
    assert worst > 50


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_with_masks_it_stays_instead_of_moving_into_walls(role: str) -> None:
    maze = connected_maze(2, 3, 4)
    task = make_task("chase", maze=maze, stay_action=True, max_steps=30)
    others: Any = {"evader": AStarEvader(0.3), "chaser": AStarChaser(0.4)}
    games, allowed = pairs_of_cells(task, maze, role), bump_masks(maze, 5)
    allowed = allowed[games.position[:, task.seat(role)]]
    free, masked = (
        GameContest(task, role, others, mask_bumps=masks)
        .optimal_policy()
        .distribution(task, games, task.seat(role))  # type: ignore[attr-defined]
        for masks in (False, True)
    )
    apart = games.position[:, 0] != games.position[:, 1]
    np.testing.assert_array_equal(masked[apart] > 0, (free > 0)[apart] & allowed[apart])
    assert (free[apart][~allowed[apart]] > 0).any()


def test_each_maze_of_a_suite_has_its_own_optimum() -> None:
    world = world_of(task="chase", role="evader", maze="suite:5x5-test/0-3")
    policy, task = world.optimal_policy(), world.task
    games = Simulator(task, 300, seed=1).games
    assert policy.optimal.__self__._solved == {}  # only when it is needed
    rows = policy.distribution(task, games, 1)
    assert len(policy.optimal.__self__._solved) == 4
    for number, maze in enumerate(task.mazes):
        here = games.maze == number
        alone: Any = GameContest(replace(task, maze=maze), "evader", world.opponents)
        cells = games.position[here]
        pairs = pairs_of_cells(alone.task, maze, "evader")
        every = alone.optimal_policy().distribution(alone.task, pairs, 1)
        np.testing.assert_array_equal(rows[here], every[cells[:, 1] * 25 + cells[:, 0]])


def test_actions_are_drawn_from_the_distribution() -> None:
    task = make_task("chase", maze="3x3-open")
    policy: Any = GameContest(task, "chaser", {"evader": AStarEvader(0.2)}).optimal_policy()
    simulator = Simulator(task, 20_000, seed=2)
    rows = policy.distribution(task, simulator.games, 0)
    played = np.bincount(policy.act(simulator.view(0)), minlength=4)
    assert played == pytest.approx(rows.sum(axis=0), abs=4 * 20_000**0.5)
    assert (rows[np.arange(20_000), policy.act(simulator.view(0))] > 0).all()
    assert repr(policy) == "OptimalPolicy(chaser_0)"


def test_it_stays_where_the_plan_of_a_team_moves_into_a_blocked_cell() -> None:
    task = make_task("chase", maze="3x3-open", num_chasers=2, stay_action=True, collisions="block")
    games = Simulator(task, 2).games
    games.position[:] = [[3, 4, 8], [0, 4, 8]]  # the other chaser is in the east, or not
    for masks, expected in ((True, [4, 2]), (False, [2, 2])):
        policy = OptimalPolicy(lambda *_: np.eye(5)[[2, 2]], task, (0,), masks)
        assert (policy.distribution(task, games, 0) == np.eye(5)[expected]).all()


@pytest.mark.parametrize("agent", ["chaser_0", "evader_0"])
def test_masked_actions_are_never_played(agent: str) -> None:
    """In games with blocked cells, and in turns, where the side that waits can only stay."""
    for rules in (
        {"collisions": "block", "capture": "adjacent", "num_chasers": 2, "mask": True},
        {"move_order": "turns", "num_exits": 1, "mask": False},
    ):
        given: Any = {**rules, "stay_action": True}
        masked = given.pop("mask")
        task = make_task("chase", maze="3x3", **given)
        others: Any = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
        contest = GameContest(task, agent, others, mask_bumps=masked)
        policy, simulator = contest.optimal_policy(), contest.starts()
        step, seat = contest.stepper(simulator, policy), contest.seat
        for _ in range(6):
            rows = policy.distribution(task, simulator.games, seat)  # type: ignore[attr-defined]
            masks = action_masks(simulator.games, lay_out(task.mazes), task)[:, seat]
            assert not rows[~masks].any()
            np.testing.assert_allclose(rows.sum(axis=1), 1.0)
            step()


# -- small games -----------------------------------------------------------------------------------


class Twins(Nim):
    """Nim in which each action of the player to move has a twin."""

    def legal_actions(self, state: Any, player: int) -> Any:
        return [(each, twin) for each in super().legal_actions(state, player) for twin in "ab"]

    def transitions(self, state: Any, actions: Any) -> Any:
        return super().transitions(state, [action for action, _ in actions])


@pytest.mark.parametrize("seed", range(5))
def test_small_games_have_all_optimal_legal_actions(seed: int) -> None:
    """By backward induction over the transitions of the game itself."""
    rules: Any = RandomGame(players=3, seed=seed) if seed < 3 else Twins()
    small = enumerate_game(rules)
    task, own = GameTask(small, max_steps=9), small.players[seed % len(small.players)]
    tables = random_tables(small, seed)
    others: Any = {
        name: TableAgent(task, name, tables[name]) for name in small.players if name != own
    }
    contest = SmallGameContest(task, own, others)
    values: dict[Any, float] = dict.fromkeys(small.states, 0.0)
    for _ in range(9):
        worth = {state: worth_of(rules, small, tables, own, state, values) for state in values}
        values = {state: max(found) for state, found in worth.items()}
    seat, table = small.player(own), contest.optimal_policy().table(task)
    rows = np.split(table, small.offsets(seat)[1:-1])
    for state, row in zip(small.states, rows, strict=True):
        optimal = np.array(worth[state]) >= max(worth[state]) - 1e-9
        np.testing.assert_allclose(row, optimal / optimal.sum())
    if seed >= 3:  # these end in 8 steps, so that the first step's policy is optimal in all
        assert all((row > 0).sum() > 1 for row in rows)
        played = returns_of(small, {**tables, own: table}, 1.0, 9)[:, seat]
        assert small.start @ played == pytest.approx(contest.best.mean_over_starts, rel=1e-12)


def worth_of(rules: Any, small: Any, tables: Any, own: str, state: Any, values: Any) -> list[float]:
    """The value of each legal action of a player in a state."""
    seat, number = small.player(own), small.states.index(state)
    legal = [rules.legal_actions(state, player) for player in range(len(small.players))]
    found = [0.0] * len(legal[seat])
    for choice in itertools.product(*(range(len(each)) for each in legal)):
        chance = 1.0
        for player, name in enumerate(small.players):
            if name != own:
                chance *= tables[name][small.offsets(player)[number] + choice[player]]
        actions = tuple(each[pick] for each, pick in zip(legal, choice, strict=True))
        for likely, after, rewards, ended in rules.transitions(state, actions):
            later = 0.0 if ended else values[after]
            found[choice[seat]] += chance * likely * (rewards[seat] + later)
    return found


# -- settings --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flat", "team"),
    [
        ({"task": "chase", "role": "chaser", "maze": "3x3", "num_chasers": 2}, False),
        ({"task": "chase", "role": "chaser", "maze": "3x3", "num_chasers": 2}, True),
        ({"task": "race", "maze": "3x3", "num_goals": 2}, False),
        ({"task": "heist", "role": "evader", "maze": "3x3", "num_goals": 1}, False),
        ({"task": "chase", "role": "evader", "maze": "4x4", "num_exits": 1}, False),
    ],
)
def test_whole_games_have_an_optimal_policy(flat: dict[str, Any], team: bool) -> None:
    world = world_of(team, **flat)
    policy, simulator = world.optimal_policy(), world.contest(50).starts()
    for seat in policy.seats:
        rows = policy.distribution(world.task, simulator.games, seat)
        assert rows.shape == (50, world.task.num_actions)
        np.testing.assert_allclose(rows.sum(axis=1), 1.0)
    assert len(policy.seats) == 1 + team


def test_a_small_game_has_a_table() -> None:
    world: Any = world_of(task="game", game="soccer")
    table = world.optimal_policy().table(world.task)
    assert table.shape == world.contest(1).best.policies[world.agent].shape


@pytest.mark.parametrize(
    ("flat", "message"),
    [
        ({"task": "chase", "view_radius": 1}, "limited view; give"),
        ({"task": "maze", "view_radius": 1, "num_goals": 2}, "limited view; give"),
        ({"task": "chase", "maze": "9x9", "num_chasers": 3, "num_evaders": 2}, "states, times"),
        ({"task": "race", "maze": "suite:5x5-test/0-3"}, "4 mazes; whole games are solved in one"),
        ({"task": "maze", "maze": "9x9", "num_goals": 19}, "19 goals; shortest tours are exact"),
        ({"task": "reacher"}, "an arm has continuous actions"),
        ({"task": "reacher", "discrete_actions": True}, "unknown optimum; take another game"),
        ({"task": "chase", "mask_bumps": True}, "may wait, which mask_bumps forbids"),
        (
            {"task": "race", "maze": "3x3", "mask_bumps": True},
            "may wait, which mask_bumps forbids without stay_action",
        ),
    ],
)
def test_where_the_optimum_is_not_known_it_says_why(flat: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"no optimal policy to imitate: .*{message}"):
        world_of(**flat).optimal_policy()


class WithoutDistribution:
    """A policy of one's own that says only what it does."""

    def act(self, view: Any) -> Any:
        return np.zeros(view.num_games, dtype=np.int32)


@pytest.mark.parametrize("opponent", [SearchingChaser(), WithoutDistribution()])
def test_an_opponent_without_a_distribution_is_named(opponent: Any) -> None:
    contest = GameContest(make_task("chase", maze="3x3"), "evader", {"chaser": opponent})
    with pytest.raises(ValueError, match=r"no optimal policy to imitate: .*no distribution"):
        contest.optimal_policy()
