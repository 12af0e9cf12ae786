"""The rules of the game: the simulator against a plain-Python reference, and drawn examples."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_mazes import any_maze, connected_maze, seeds, small_maze
from reference_rules import Game, Outcome, drawn, of_role, step

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from pursuit.rules import batches, layout
from pursuit.rules.layout import (
    CAPTURED,
    COLLECTED,
    EAST,
    NORTH,
    SOUTH,
    STAY,
    WAS_CAPTURED,
    WEST,
)
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.rewards import rewards_text
from pursuit.tasks.task import REWARD_SCHEMES, Rewards, Task

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
ROOM = load_maze("3x3-open")  # cells 0 1 2 / 3 4 5 / 6 7 8

amounts = st.sampled_from([-1.0, -0.1, 0.0, 0.3, 2.0])
role_rewards = st.builds(Rewards, amounts, amounts, amounts, amounts, st.booleans())
per_evader = st.builds(Rewards, amounts, amounts, amounts, per_evader=st.just(True))
schemes = st.sampled_from(sorted(REWARD_SCHEMES)) | st.fixed_dictionaries(
    {},
    optional={
        "chaser": role_rewards | per_evader,
        "evader": role_rewards,
        "runner": role_rewards,
    },
)


@st.composite
def tasks(draw: st.DrawFn) -> Task:
    """Any valid task: all roles, in any maze that is large enough."""
    chasers, evaders, runners, goals = (draw(st.integers(0, most)) for most in (3, 3, 3, 4))
    collectors = evaders + runners
    if not collectors:
        evaders = collectors = 1
    if runners or not (chasers and evaders):
        goals = max(goals, 1)
    maze = draw(small_maze | st.sampled_from([CORRIDOR, ROOM]) if goals else any_maze)
    assume(chasers + collectors + goals <= maze.num_cells)
    return Task(
        maze=maze,
        num_chasers=chasers,
        num_evaders=evaders,
        num_runners=runners,
        num_goals=goals,
        max_steps=draw(st.integers(1, 12)),
        stay_action=draw(st.booleans()),
        move_order=draw(st.sampled_from(["simultaneous", "chasers_first"])),
        rewards=draw(schemes),
    )


def read(simulator: Simulator) -> Game:
    """The only game of the simulator, as the reference sees it."""
    task = simulator.task
    maze = task.mazes[simulator.maze_index[0]]
    cells, names = drawn(maze.to_text())[0], task.agent_names
    return Game(
        maze,
        {name: cells[cell] for name, cell in zip(names, simulator.positions[0], strict=True)},
        frozenset(name for name, on in zip(names, simulator.active[0], strict=True) if on),
        {number: cells[cell] for number, cell in enumerate(simulator.goals[0]) if cell >= 0},
        int(simulator.steps[0]),
    )


def events_of(outcome: Outcome, agents: tuple[str, ...]) -> list[int]:
    captors = set().union(*outcome.captures.values())
    takers = set().union(*outcome.collected.values())
    return [
        COLLECTED * (agent in takers)
        + CAPTURED * (agent in captors)
        + WAS_CAPTURED * (agent in outcome.captures)
        for agent in agents
    ]


def step_both(simulator: Simulator, actions: Any) -> Outcome:
    """One step by the simulator and by the reference; they must agree in everything."""
    task, names = simulator.task, simulator.task.agent_names
    by_name = dict(zip(names, np.asarray(actions).tolist(), strict=True))
    expected = step(read(simulator), by_name, task.role_rewards, task.move_order, task.max_steps)
    returns, collected = simulator.returns[0].copy(), simulator.collected[0].copy()
    simulator.step([actions])
    assert read(simulator) == expected.game
    assert simulator.events[0].tolist() == events_of(expected, names)
    paid = [expected.rewards[name] for name in names]
    np.testing.assert_allclose(simulator.rewards[0], paid, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(simulator.returns[0], returns + paid, rtol=1e-6, atol=1e-6)
    taken = [sum(1 / len(t) for t in expected.collected.values() if n in t) for n in names]
    np.testing.assert_allclose(simulator.collected[0], collected + taken)
    assert simulator.terminated[0] == expected.terminated
    assert simulator.truncated[0] == expected.truncated
    return expected


@settings(max_examples=400, deadline=None)
@given(tasks(), seeds)
def test_every_step_is_that_of_the_reference(task: Task, seed: int) -> None:
    simulator = Simulator(task, seed=seed, auto_restart=False)
    rng = np.random.default_rng(seed)
    for _ in range(task.max_steps):
        outcome = step_both(simulator, rng.integers(task.num_actions, size=task.num_agents))
        if outcome.terminated or outcome.truncated:
            return
    raise AssertionError("the episode outlived max_steps")


@pytest.mark.parametrize("move_order", ["simultaneous", "chasers_first"])
def test_crowds_whose_cells_and_numbers_share_bits_are_captured_as_in_the_reference(
    move_order: str,
) -> None:
    """More than 64 cells and more than 64 chasers, which share bits of a word."""
    maze = generate_maze("prim", 12, loops=0.4, seed=3)
    rules: dict[str, Any] = {"max_steps": 30, "stay_action": True, "move_order": move_order}
    task = Task(maze, num_chasers=70, num_evaders=40, **rules)
    simulator, captured = Simulator(task, seed=2, auto_restart=False), 0
    rng = np.random.default_rng(0)
    while not simulator.ended.any():
        outcome = step_both(simulator, rng.integers(5, size=task.num_agents))
        captured += sum(len(captors) > 1 for captors in outcome.captures.values())
    assert captured > 1


def test_random_play_of_the_reference_meets_every_case() -> None:
    """Ensures that the comparison above covers rare cases."""
    met = set()
    for seed in range(300):
        task = Task(
            maze=connected_maze(seed, 3, 5),
            num_chasers=2,
            num_evaders=2,
            num_runners=2,
            num_goals=1,
            max_steps=8,
            move_order=("simultaneous", "chasers_first")[seed % 2],
        )
        simulator = Simulator(task, seed=seed, auto_restart=False)
        rng = np.random.default_rng(seed)
        while not simulator.ended.any():
            before = read(simulator)
            outcome = step_both(simulator, rng.integers(4, size=task.num_agents))
            for evader, captors in outcome.captures.items():
                met.add(f"{len(captors)} captors, {task.move_order}")
                if outcome.game.places[evader] not in map(outcome.game.places.get, captors):
                    met.add("swap")
                if before.goals and outcome.game.places[evader] in before.goals.values():
                    met.add("captured on a goal")
            for takers in outcome.collected.values():
                met.add(f"taken by {len(takers)}")
                met |= {f"taken by {agent[:6]}" for agent in takers}
            met |= {"terminated"} if outcome.terminated else set()
            met |= {"truncated"} if outcome.truncated else set()
            if len(of_role(outcome.game.active, "evader")) == 1:
                met.add("one evader left")
    assert met >= {
        *(f"{n} captors, {order}" for n in (1, 2) for order in ("simultaneous", "chasers_first")),
        *("swap", "captured on a goal", "taken by 1", "taken by 2", "taken by evader"),
        *("taken by runner", "terminated", "truncated", "one evader left"),
    }


# -- drawn examples --------------------------------------------------------------------------------


def play(positions: list[int], actions: list[int], goals: Any = None, **task: Any) -> Simulator:
    """One step from a drawn position; checked against the reference as well."""
    settings = {"maze": CORRIDOR, "num_goals": len(goals or ()), **task}
    simulator = Simulator(Task(**settings), auto_restart=False)
    simulator.place(positions, goals)
    step_both(simulator, actions)
    return simulator


DUEL = {"num_chasers": 1, "num_evaders": 1}


def test_a_move_into_a_wall_leaves_the_agent_in_place() -> None:
    game = play([0, 4], [WEST, NORTH], **DUEL)
    assert game.positions.tolist() == [[0, 4]]
    assert not game.terminated[0] and game.rewards.tolist() == [[np.float32(-0.1), 1.0]]


def test_agents_in_the_same_cell_after_the_move_meet() -> None:
    game = play([1, 3], [EAST, WEST], **DUEL)
    assert game.positions.tolist() == [[2, 2]] and game.terminated[0]
    assert game.rewards.tolist() == [[1.0, -1.0]]


def test_agents_that_swap_cells_meet() -> None:
    game = play([1, 2], [EAST, WEST], **DUEL)
    assert game.positions.tolist() == [[2, 1]] and game.terminated[0]
    assert game.active.tolist() == [[1, 0]]
    assert game.events.tolist() == [[CAPTURED, WAS_CAPTURED]]


def test_an_evader_that_runs_ahead_escapes_unless_chasers_move_first() -> None:
    assert not play([1, 2], [EAST, EAST], **DUEL).terminated[0]
    game = play([1, 2], [EAST, EAST], move_order="chasers_first", **DUEL)
    assert game.terminated[0] and game.positions.tolist() == [[2, 2]]


def test_with_chasers_first_an_evader_may_still_run_into_a_chaser() -> None:
    game = play([1, 3], [EAST, WEST], move_order="chasers_first", **DUEL)
    assert game.terminated[0] and game.positions.tolist() == [[2, 2]]


def test_with_chasers_first_a_chaser_that_left_cannot_be_swapped_with() -> None:
    game = play([2, 3], [WEST, WEST], move_order="chasers_first", **DUEL)
    assert not game.terminated[0] and game.positions.tolist() == [[1, 2]]


def test_captors_of_one_evader_share_it_equally() -> None:
    game = play([1, 3, 2], [EAST, WEST, NORTH], num_chasers=2, num_evaders=1)
    assert game.rewards.tolist() == [[0.5, 0.5, -1.0]] and game.terminated[0]


def test_a_chaser_may_capture_two_evaders_at_once() -> None:
    game = play([1, 2, 3], [EAST, NORTH, WEST], num_chasers=1, num_evaders=2)
    assert game.rewards.tolist() == [[2.0, -1.0, -1.0]] and game.terminated[0]


def test_a_captured_evader_leaves_and_the_game_goes_on() -> None:
    game = play([0, 1, 4], [EAST, NORTH, NORTH], num_chasers=1, num_evaders=2)
    assert not game.terminated[0] and game.active.tolist() == [[1, 0, 1]]
    assert game.rewards.tolist() == [[1.0, -1.0, 1.0]]
    step_both(game, [WEST, EAST, NORTH])
    assert game.positions.tolist() == [[0, 1, 4]]  # it neither moves nor earns
    assert game.rewards.tolist() == [[np.float32(-0.1), 0.0, 1.0]]
    step_both(game, [EAST, NORTH, NORTH])  # nor is it caught again
    assert game.events.tolist() == [[0, 0, 0]]


def test_runners_that_arrive_at_once_share_the_goal() -> None:
    game = play([1, 3, 4], [EAST, WEST, NORTH], [2, 0], num_runners=3)
    assert game.rewards.tolist() == [[0.5, 0.5, np.float32(-0.1)]]
    assert game.goals.tolist() == [[-1, 0]] and not game.terminated[0]


def test_goals_are_counted_by_agent_until_the_next_episode() -> None:
    game = play([1, 3, 4], [EAST, WEST, WEST], [2, 0], num_runners=3)
    assert game.collected.tolist() == [[0.5, 0.5, 0.0]]
    step_both(game, [WEST, NORTH, NORTH])
    step_both(game, [WEST, NORTH, NORTH])
    assert game.terminated[0] and game.collected.tolist() == [[1.5, 0.5, 0.0]]
    game.reset()
    assert game.collected.tolist() == [[0.0, 0.0, 0.0]]


def test_the_last_goal_ends_the_game() -> None:
    game = play([1], [EAST], [2], num_runners=1)
    assert game.terminated[0] and game.rewards.tolist() == [[1.0]]


def test_a_captured_evader_collects_nothing() -> None:
    game = play([1, 3], [EAST, WEST], [2], **DUEL)
    assert game.goals.tolist() == [[2]] and game.events.tolist() == [[CAPTURED, WAS_CAPTURED]]


def test_chasers_neither_collect_goals_nor_capture_runners() -> None:
    game = play([1, 4, 2], [EAST, NORTH, NORTH], [0], num_chasers=1, num_evaders=1, num_runners=1)
    assert game.positions.tolist() == [[2, 4, 2]] and game.active.all()
    step_both(game, [WEST, NORTH, NORTH])
    step_both(game, [WEST, NORTH, NORTH])
    assert game.positions[0, 0] == 0 and game.goals.tolist() == [[0]]


def test_termination_wins_over_truncation() -> None:
    game = play([1, 3], [EAST, WEST], max_steps=1, **DUEL)
    assert game.terminated[0] and not game.truncated[0]
    game = play([0, 4], [EAST, WEST], max_steps=1, **DUEL)
    assert game.truncated[0] and not game.terminated[0]


def test_a_game_without_goals_does_not_end_at_once() -> None:
    game = play([0, 4], [EAST, WEST], [-1], **DUEL)
    assert not game.ended.any()


def test_staying_is_a_move_that_can_capture() -> None:
    game = play([2, 3], [STAY, WEST], stay_action=True, **DUEL)
    assert game.terminated[0] and game.positions.tolist() == [[2, 2]]


def test_completion_rewards_events_only_in_the_last_step() -> None:
    task = {"num_runners": 1, "rewards": "completion"}
    assert play([1], [EAST], [2, 4], **task).rewards.tolist() == [[np.float32(-0.1)]]
    assert play([1], [EAST], [2], **task).rewards.tolist() == [[1.0]]


def test_completion_rewards_the_capture_of_an_evader_before_the_end() -> None:
    chase = {"num_chasers": 1, "num_evaders": 2, "rewards": "completion"}
    game = play([0, 1, 4], [EAST, NORTH, NORTH], **chase)
    assert not game.terminated[0]
    assert game.rewards.tolist() == [[np.float32(-0.1), -1.0, 1.0]]


def test_distance_rewards_use_the_manhattan_distance_after_the_move() -> None:
    game = play([0, 8], [SOUTH, WEST], maze=ROOM, rewards="distance", **DUEL)
    assert game.positions.tolist() == [[3, 7]] and game.rewards.tolist() == [[-2.0, 2.0]]


def test_zero_sum_returns_are_the_length_of_the_chase() -> None:
    task = Task(maze=ROOM, num_chasers=1, num_evaders=1, rewards="zero_sum")
    simulator = Simulator(task, 64, seed=1)
    rng = np.random.default_rng(0)
    for _ in range(250):
        simulator.step(rng.integers(4, size=(64, 2)))
    lengths = simulator.episode_lengths
    assert (lengths > 0).all()
    np.testing.assert_array_equal(simulator.episode_returns, np.c_[-lengths, lengths])


@pytest.mark.parametrize("move_order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize(("chasers", "evaders"), [(2, 1), (1, 2), (2, 2)])
def test_zero_sum_rewards_count_free_evaders_in_all_states_and_actions(
    chasers: int, evaders: int, move_order: Any
) -> None:
    """By enumeration: all cells, all that can be free, all joint actions."""
    maze = Maze.from_text("+-+-+-+-+\n|       |\n+-+-+-+-+")
    task = Task(maze, chasers, evaders, move_order=move_order, rewards="zero_sum")
    agents = range(task.num_agents)
    cases = [
        (cells, free, actions)
        for cells in itertools.product(range(4), repeat=task.num_agents)
        for free in itertools.product((0, 1), repeat=evaders)
        for actions in itertools.product((NORTH, EAST, WEST), repeat=task.num_agents)
        if any(free)
    ]
    simulator = Simulator(task, len(cases), auto_restart=False)
    simulator.positions[:] = [cells for cells, _, _ in cases]
    simulator.active[:, chasers:] = [free for _, free, _ in cases]
    simulator.step([actions for _, _, actions in cases])
    expected = []
    for _, free, _ in cases:
        left = dict(zip(agents[chasers:], free, strict=True))
        expected.append([left[agent] if agent in left else -sum(free) for agent in agents])
    np.testing.assert_array_equal(simulator.rewards, expected)
    # One chaser and all evaders: zero-sum in every step.
    np.testing.assert_array_equal(simulator.rewards[:, [0, *agents[chasers:]]].sum(axis=1), 0.0)


def test_zero_sum_of_goals_is_the_opposite_for_chasers() -> None:
    heist: dict[str, Any] = {"maze": ROOM, "num_chasers": 2, "rewards": "zero_sum"}
    game = play([0, 1, 3, 5], [NORTH, NORTH, EAST, WEST], [4, 8], num_evaders=2, **heist)
    assert game.rewards.tolist() == [[-1.0, -1.0, 0.5, 0.5]]  # two evaders share a goal
    game = play([0, 1, 3], [NORTH, NORTH, EAST], [4, 8], num_evaders=1, **heist)
    assert game.rewards.tolist() == [[-1.0, -1.0, 1.0]]


def test_rewards_per_evader_are_for_chasers_and_for_events_at_once() -> None:
    for wrong in ({"distance": -1.0}, {"on_completion": True}):
        with pytest.raises(ValueError, match="requires distance=0, touch=0, on_completion=False"):
            Rewards(per_evader=True, **wrong)  # type: ignore[arg-type]
    for role in ("evader", "runner"):
        with pytest.raises(ValueError, match=f"of the {role}: per_evader=True; only chasers"):
            Task(ROOM, 1, 1, rewards={role: Rewards(per_evader=True)})
    with pytest.raises(ValueError, match="of the evader: per_evader=True"):
        Task(ROOM, 1, 1, rewards="step=-1,per_evader=true")
    text = "chaser.step=-1,chaser.per_evader=true"
    assert Task(ROOM, 1, 1, rewards=text).role_rewards["chaser"] == Rewards(-1.0, per_evader=True)
    assert rewards_text(text) == text


# -- the rules compiled for known teams ------------------------------------------------------------


def step_as_any_task(simulator: Simulator, actions: NDArray[np.int32]) -> None:
    """One step by the rules compiled for any teams."""
    step_any = batches.entry_for(-1, -1, -1, -1, True)
    mode = layout.RESTART if simulator.auto_restart else layout.NO_RESTART
    done = step_any(*simulator._kernel_arrays, actions, mode)
    assert done == layout.OK


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    any_maze,
    seeds,
    st.sampled_from(["simultaneous", "chasers_first"]),
    st.booleans(),
    schemes,
    st.integers(1, 9),
    st.booleans(),
    st.integers(0, 3),
)
def test_rules_compiled_for_known_teams_follow_the_general_rules_bit_for_bit(
    maze: Maze,
    seed: int,
    order: str,
    stay: bool,
    scheme: Any,
    max_steps: int,
    restart: bool,
    num_goals: int,
) -> None:
    assume(maze.num_cells >= num_goals + 4 and (maze.is_connected or not num_goals))
    teams: dict[str, int] = {"num_chasers": 1, "num_evaders": 1}
    if not num_goals and seed % 3:  # 2v2 and 3v1
        chasers = 1 + seed % 3
        teams = {"num_chasers": chasers, "num_evaders": 4 - chasers}
    if num_goals:
        teams = {"num_runners": 1, "num_goals": num_goals}
    task = Task(
        maze=maze,
        move_order=order,
        stay_action=stay,
        rewards=scheme,
        max_steps=max_steps,
        **teams,  # type: ignore[arg-type]
    )
    fast, general = (Simulator(task, 16, seed, auto_restart=restart) for _ in range(2))
    rng = np.random.default_rng(seed)
    for _ in range(20):
        actions = rng.integers(task.num_actions, size=(16, task.num_agents), dtype=np.int32)
        fast.step(actions)
        step_as_any_task(general, actions)
        for one, other in zip(fast._kernel_arrays, general._kernel_arrays, strict=True):
            if one is not fast._kernel_arrays[-1]:  # scratch memory differs
                np.testing.assert_array_equal(one, other)
