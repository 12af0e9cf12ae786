"""A simulator written from docs/explanation/rules.md alone, on random graphs and mixes of agents.

On grids, `reference_rules` is compared step by step in test_rules.py.
"""

from __future__ import annotations

import itertools
from typing import Any

import networkx
import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Rewards, Task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    TablePolicy,
    TourRunner,
    evaluate_joint,
)

FAR = float("inf")


def random_graph(rng: np.random.Generator, kind: Any) -> Any:
    """A connected graph with long, parallel and opposite edges."""
    size = int(rng.integers(3, 7))
    graph = kind()
    graph.add_nodes_from(rng.permutation(size).tolist())
    ring = rng.permutation(size).tolist()
    pairs = [*zip(ring, ring[1:] + ring[:1], strict=True)]
    pairs += [tuple(rng.choice(size, 2, replace=False).tolist()) for _ in range(size)]
    for a, b in pairs:
        if kind is networkx.MultiGraph or not graph.has_edge(a, b):
            graph.add_edge(a, b, length=int(rng.integers(1, 4)))
    return graph


class Board:
    """Cells and distances, as the page defines them."""

    def __init__(self, graph: Any) -> None:
        nodes = list(graph.nodes)
        length: dict[Any, int] = {}
        for u, v, data in graph.edges(data=True):
            key = (v, u) if not graph.is_directed() and (v, u) in length else (u, v)
            length[key] = min(length.get(key, 99), data["length"])
        inner: dict[Any, list[int]] = {}  # the inner cells on the way from one node to another
        self.actions: list[list[int]] = [[] for _ in nodes]
        for (u, v), n in length.items():
            both = not graph.is_directed() or length.get((v, u)) == n
            if (u, v) in inner:  # shared with the opposite edge
                continue
            way = [len(self.actions) + i for i in range(n - 1)]
            ends = [nodes.index(u), *way, nodes.index(v)]
            for before, _, after in zip(ends, ends[1:], ends[2:], strict=False):
                self.actions.append([after, before] if both else [after])
            inner[u, v] = way
            if both:
                inner[v, u] = way[::-1]
        for number, node in enumerate(nodes):
            for there in graph.adj[node]:
                self.actions[number].append([*inner[node, there], nodes.index(there)][0])
        self.moves = max(map(len, self.actions))
        for cell, found in enumerate(self.actions):
            found += [cell] * (self.moves - len(found))
        self.away = [self.search(cell) for cell in range(len(self.actions))]

    def search(self, origin: int) -> list[float]:
        steps = [FAR] * len(self.actions)
        steps[origin], reached = 0, [origin]
        for cell in reached:
            for there in self.actions[cell]:
                if steps[there] == FAR:
                    steps[there] = steps[cell] + 1
                    reached.append(there)
        return steps

    def towards(self, own: int, targets: list[int]) -> set[int]:
        return {
            action
            for action, there in enumerate(self.actions[own])
            for target in targets
            if self.away[there][target] == self.away[own][target] - 1
        }

    def nearest(self, own: int, targets: list[int]) -> list[int]:
        least = min((self.away[own][target] for target in targets), default=FAR)
        return [target for target in targets if self.away[own][target] == least < FAR]


class Game:
    """The state of a game, and one step of it."""

    def __init__(self, task: Task, board: Board, simulator: Simulator) -> None:
        self.task, self.board = task, board
        self.cells = simulator.positions[0].tolist()
        self.goals = simulator.goals[0].tolist()
        self.free = [True] * task.num_agents
        self.steps = 0

    def seats(self, role: str) -> list[int]:
        return [s for s, r in enumerate(self.task.seat_roles) if r == role]

    def row(self, seat: int, policy: Any) -> NDArray[np.float64]:
        """The probabilities of the actions of a scripted agent."""
        board, own, stay = self.board, self.cells[seat], self.board.moves
        every = {a for a, there in enumerate(board.actions[own]) if there != own}
        left = [cell for cell in self.goals if cell >= 0]
        if isinstance(policy, AStarChaser):
            evaders = [self.cells[s] for s in self.seats("evader") if self.free[s]]
            greedy = board.towards(own, board.nearest(own, evaders))
        elif isinstance(policy, TourRunner):
            greedy = board.towards(own, self.first_goal(own, left))
        elif isinstance(policy, NearestGoalRunner):
            greedy = board.towards(own, board.nearest(own, left))
        else:
            chasers = [self.cells[s] for s in self.seats("chaser")]
            watched = min(chasers, key=lambda cell: board.away[cell][own], default=None)
            greedy = every
            if watched is not None and board.away[watched][own] < policy.alert_distance:
                near = [c for c, steps in enumerate(board.away[own]) if steps <= policy.look_radius]
                most = max(board.away[watched][cell] for cell in near)
                targets = [cell for cell in near if board.away[watched][cell] == most]
                if most > board.away[watched][own]:
                    greedy = board.towards(own, targets)
                elif self.task.stay_action:
                    greedy = {stay}
        row = np.zeros(self.task.num_actions)
        for share, chosen in ((policy.epsilon, every), (1 - policy.epsilon, greedy or every)):
            row[list(chosen)] += share / len(chosen)
        return row

    def first_goal(self, own: int, goals: list[int]) -> list[int]:
        """The first goal of a shortest tour; of several the first in the order of goals."""

        def length(tour: Any) -> float:
            return sum(self.board.away[a][b] for a, b in itertools.pairwise((own, *tour)))

        tours = list(itertools.permutations(goals))  # in the order of goals
        return [min(tours, key=length)[0]] if goals else []

    def step(self, actions: list[int]) -> tuple[bool, bool, list[float]]:
        """Whether the game terminates and is truncated, and the rewards."""
        before, was_free = list(self.cells), list(self.free)
        chasers, evaders = self.seats("chaser"), self.seats("evader")
        captors: dict[int, list[int]] = {}
        groups = [[*range(self.task.num_agents)]]
        if self.task.move_order == "chasers_first":
            groups = [chasers, [s for s in groups[0] if s not in chasers]]
        for group in groups:
            for seat in group:
                if self.free[seat] and actions[seat] < self.board.moves:
                    self.cells[seat] = self.board.actions[before[seat]][actions[seat]]
            for evader in evaders:
                if not self.free[evader]:
                    continue
                captors[evader] = [
                    chaser
                    for chaser in chasers
                    if self.cells[chaser] == self.cells[evader]
                    or (
                        (len(groups) == 1 and self.cells[chaser] == before[evader])
                        and self.cells[evader] == before[chaser]
                    )
                ]
                self.free[evader] = not captors[evader]
        collectors = [s for s in [*evaders, *self.seats("runner")] if self.free[s]]
        takers = [[s for s in collectors if self.cells[s] == goal] for goal in self.goals]
        self.goals = [-1 if found else goal for goal, found in zip(self.goals, takers, strict=True)]
        self.steps += 1
        none_left = any(takers) and max(self.goals) < 0
        terminated = none_left or bool(evaders and not any(self.free[s] for s in evaders))
        rewards = []
        for seat, role in enumerate(self.task.seat_roles):
            pay = self.task.role_rewards[role]
            taken = [pay.goal / len(found) for found in takers if seat in found]
            events = taken + [pay.capture / len(c) for c in captors.values() if seat in c]
            reward = pay.step
            if events and (terminated or not pay.on_completion):
                reward = sum(events)
            if pay.per_evader:
                reward = 0.0
                for evader in [e for e in evaders if was_free[e]]:
                    goals = [pay.goal / len(found) for found in takers if evader in found]
                    reward += pay.capture if captors[evader] else sum(goals) if goals else pay.step
            if role == "evader" and not self.free[seat]:
                reward = pay.capture if was_free[seat] else 0.0
            rewards.append(reward)
        return terminated, not terminated and self.steps >= self.task.max_steps, rewards


def random_task(rng: np.random.Generator, maze: Maze) -> Task:
    """Any mix of roles, also such as no named task has."""
    while True:
        chasers, evaders, runners, goals = rng.integers((3, 3, 3, 4)).tolist()
        amounts = rng.choice([-1.0, -0.1, 0.5, 2.0], (3, 3))
        rewards = {
            role: Rewards(*row.tolist(), on_completion=bool(rng.integers(2)))
            for role, row in zip(("chaser", "evader", "runner"), amounts, strict=True)
        }
        if rng.integers(2):
            rewards["chaser"] = Rewards(*amounts[0].tolist(), per_evader=True)
        try:
            return Task(
                maze,
                chasers,
                evaders,
                runners,
                goals,
                max_steps=int(rng.integers(1, 12)),
                stay_action=bool(rng.integers(2)),
                move_order=("simultaneous", "chasers_first")[rng.integers(2)],
                rewards=rewards,
            )
        except ValueError:  # a mix that cannot end, or does not fit
            continue


@pytest.mark.parametrize("kind", [networkx.Graph, networkx.DiGraph, networkx.MultiGraph])
def test_whole_games_are_those_of_the_page(kind: Any) -> None:
    rng = np.random.default_rng(3)
    met = set()
    for seed in range(60):
        graph = random_graph(rng, kind)
        maze, board = Maze.from_graph(graph), Board(graph)
        assert maze.neighbors[:, :-1].tolist() == board.actions
        task = random_task(rng, maze)
        policies = [
            {
                "chaser": AStarChaser(rng.choice([0.0, 0.3])),
                "evader": [
                    AStarEvader(0.2),
                    AStarEvader(0.0, 4, 2),
                    NearestGoalRunner() if task.num_goals else AStarEvader(look_radius=5),
                ][seed % 3],
                "runner": [NearestGoalRunner(0.1), TourRunner()][seed % 2],
            }[role]
            for role in task.seat_roles
        ]
        simulator = Simulator(task, seed=seed, auto_restart=False)
        game, terminated, truncated = Game(task, board, simulator), False, False
        while not (terminated or truncated):
            view, actions = simulator.view(0), []
            for seat, policy in enumerate(policies):
                row = game.row(seat, policy)
                if game.free[seat] and not (isinstance(policy, TourRunner) and task.num_goals > 1):
                    known = policy.distribution(task, view.games, seat)[0]
                    np.testing.assert_allclose(known, row, atol=1e-12)
                elif game.free[seat]:  # it has no distribution; what it does is possible
                    drawn = {int(policy.act(simulator.view(seat))[0]) for _ in range(8)}
                    assert drawn <= set(np.flatnonzero(row))
                actions.append(int(rng.choice(task.num_actions, p=row)))
            simulator.step([actions])
            terminated, truncated, rewards = game.step(actions)
            assert simulator.positions[0].tolist() == game.cells
            assert simulator.active[0].astype(bool).tolist() == game.free
            assert simulator.goals[0].tolist() == game.goals
            assert (bool(simulator.terminated[0]), bool(simulator.truncated[0])) == (
                terminated,
                truncated,
            )
            np.testing.assert_allclose(simulator.rewards[0], rewards, atol=1e-6)
        met |= {"terminated" if terminated else "truncated", *task.seat_roles}
        met |= {"mixed"} if len(set(task.seat_roles)) == 3 else set()
    assert met == {"terminated", "truncated", "chaser", "evader", "runner", "mixed"}


def test_of_equally_near_chasers_the_evader_watches_the_first() -> None:
    """So the chasers of a team with equal policies can have unequal returns."""
    maze = Maze.from_graph(networkx.path_graph(7))  # chasers at 2 and 4, the evader between
    policy, rows = AStarEvader(look_radius=1), []
    for cells in ([2, 4, 3], [4, 2, 3]):
        simulator = Simulator(Task(maze, 2, 1), auto_restart=False)
        simulator.place(cells)
        rows.append(policy.distribution(simulator.task, simulator.view(2).games, 2)[0])
    away = [int(np.flatnonzero(maze.neighbors[3, :-1] == cell)[0]) for cell in (4, 2)]
    assert [row.argmax() for row in rows] == away and rows[0].max() == rows[1].max() == 1.0


@pytest.mark.parametrize(("horizon", "discount"), [(1, 1.0), (4, 1.0), (4, 0.7)])
def test_ended_and_length_are_the_sums_of_the_page(horizon: int, discount: float) -> None:
    """`ended`: discount**(t - 1) times the probability of a termination in step t."""
    graph = networkx.path_graph(3)
    networkx.set_edge_attributes(graph, 1, "length")
    maze, board = Maze.from_graph(graph), Board(graph)
    task = Task(maze, num_chasers=1, num_evaders=1, max_steps=50)
    table = np.random.default_rng(0).dirichlet(np.ones(2), size=(3, 3))
    policies: dict[str, Any] = {r: TablePolicy(maze, table) for r in ("chaser", "evader")}
    simulator = Simulator(task, auto_restart=False)
    ended = length = 0.0
    starts = list(itertools.permutations(range(3), 2))
    for start in starts:
        games = {start: 1 / len(starts)}
        for t in range(1, horizon + 1):
            after: dict[Any, float] = {}
            for (c, e), share in games.items():
                length += share * discount ** (t - 1)
                for actions in itertools.product(range(2), repeat=2):
                    game = Game(task, board, simulator)
                    game.cells = [c, e]
                    chance = share * table[c, e, actions[0]] * table[e, c, actions[1]]
                    if game.step(list(actions))[0]:
                        ended += chance * discount ** (t - 1)
                    else:
                        key = tuple(game.cells)
                        after[key] = after.get(key, 0.0) + chance
            games = after
    found = evaluate_joint(task, policies, horizon, discount)
    assert found.ended == pytest.approx(ended) and found.length == pytest.approx(length)
