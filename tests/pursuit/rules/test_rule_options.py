"""The options of the rules: the simulator beside a reference in plain Python; slips; starts."""

from __future__ import annotations

import copy
import itertools
import pickle
from collections import Counter
from typing import Any

import numpy as np
import pytest
from option_tasks import CORRIDOR, ONE_WAY, TORUS, play_both, random_task
from reference_options import Rulebook
from scipy.stats import chisquare
from simulated import assert_equal, assert_same, play

from pursuit.mazes.maze import Maze
from pursuit.rules.layout import CAPTURED, COLLECTED, ESCAPED, WAS_CAPTURED
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.options import check_slip, slip_text
from pursuit.tasks.task import Rewards, Task, make_task
from scripted_agents import AStarChaser, AStarEvader

ROOM = Maze.from_text(
    "+-+-+-+\n" + "|     |\n+ + + +\n" * 2 + "|     |\n+-+-+-+"
)  # cells 0 1 2 / 3 4 5 / 6 7 8
KINDS = list(
    itertools.product(
        ("simultaneous", "chasers_first", "turns"),
        ("cell", "adjacent", "surround"),
        ("share", "block"),
    )
)


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_every_step_is_that_of_the_reference(kind: tuple[str, str, str]) -> None:
    move_order, capture, collisions = kind
    fixed = {"move_order": move_order, "capture": capture, "collisions": collisions}
    rng = np.random.default_rng(KINDS.index(kind))
    for _ in range(8):
        play_both(random_task(rng, **fixed), rng, 4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_every_step_is_that_of_the_reference_in_many_tasks(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    for _ in range(250):
        play_both(random_task(rng), rng)


@pytest.mark.parametrize("capture", ["cell", "adjacent", "surround"])
def test_random_play_covers_the_cases_of_the_comparison(capture: str) -> None:
    """Several captors and escapes, blocked moves, and ends of every kind occur."""
    met: Counter[str] = Counter()
    rng = np.random.default_rng(5)
    for collisions in ("share", "block"):
        common: dict[str, Any] = {"max_steps": 8, "capture": capture, "collisions": collisions}
        for task in (
            Task(CORRIDOR, 3, 1, exits=[2], **common),
            Task(TORUS, 3, 2, num_goals=1, num_exits=2, **common),
            Task("5x5", 1, 2, num_goals=3, num_exits=4, **common),
        ):
            for result in play_both(task, rng, 30):
                events = result.events
                met["several captors"] += sum(bool(e & CAPTURED) for e in events[:3]) > 1
                met["captures"] += any(e & WAS_CAPTURED for e in events)
                met["escapes"] += any(e & ESCAPED for e in events)
                met["goals"] += any(e & COLLECTED for e in events)
                met["terminated"] += result.terminated
                met["truncated"] += result.truncated
    assert len(met) == 6 and min(met.values()) > 0, met


# -- drawn examples of the definitions -------------------------------------------------------------


def one_step(positions: list[int], actions: list[int], **settings: Any) -> Simulator:
    """One step of agents placed in the corridor 0 to 4, with stay as action 4."""
    defaults = {"maze": CORRIDOR, "stay_action": True, "num_evaders": 1}
    task = Task(**{**defaults, "num_chasers": len(positions) - 1, **settings})
    simulator = Simulator(task, auto_restart=False)
    simulator.place(positions)
    simulator.step([actions])
    return simulator


EAST, WEST, STAY = 2, 3, 4


def test_adjacent_captures_at_distance_one_and_shares_the_reward() -> None:
    game = one_step([0, 3, 2], [STAY, STAY, STAY], capture="adjacent")
    assert game.terminated[0] and game.rewards.tolist() == [[np.float32(-0.1), 1.0, -1.0]]
    game = one_step([1, 3, 2], [STAY, STAY, STAY], capture="adjacent", n_catch=2)
    assert game.terminated[0] and game.rewards.tolist() == [[0.5, 0.5, -1.0]]
    assert not one_step([0, 3, 2], [STAY] * 3, capture="adjacent", n_catch=2).terminated[0]


def test_adjacent_follows_one_way_edges_from_the_chaser() -> None:
    """The edge from 0 to 1 is one-way: a chaser in 1 is at a distance of more than 1 from 0."""
    stay = ONE_WAY.num_moves
    for cells, captured in (([0, 1], True), ([1, 0], False)):
        game = one_step(cells, [stay, stay], maze=ONE_WAY, capture="adjacent")
        assert bool(game.terminated[0]) is captured


def test_a_swap_counts_with_n_catch_only_if_all_move_at_once() -> None:
    for move_order, captured in (("simultaneous", True), ("chasers_first", False)):
        rules = {"n_catch": 2, "move_order": move_order}
        game = one_step([1, 3, 2], [EAST, WEST, WEST], num_chasers=2, **rules)
        assert bool(game.terminated[0]) is (move_order == "chasers_first")  # both reach cell 2
        game = one_step([1, 0, 2], [EAST, EAST, WEST], num_chasers=2, **rules)
        assert bool(game.terminated[0]) is captured  # one swaps, one reaches cell 1


def test_an_enclosed_evader_is_never_surrounded_and_a_dead_end_needs_one_chaser() -> None:
    enclosed = Maze.from_text("+-+-+-+\n| |   |\n+-+-+-+")
    task = Task(enclosed, 1, 1, stay_action=True, capture="surround", max_steps=3)
    simulator = Simulator(task, auto_restart=False)
    simulator.place([1, 0])
    for _ in range(3):
        simulator.step([[STAY, STAY]])
    assert simulator.truncated[0]
    assert one_step([1, 0], [STAY, STAY], capture="surround").terminated[0]
    assert not one_step([1, 2], [STAY, STAY], capture="surround").terminated[0]


def test_blocked_moves_do_not_follow_swap_or_meet() -> None:
    for actions, after in (
        ([EAST, EAST, STAY], [0, 2, 4]),  # no following
        ([EAST, WEST, STAY], [0, 1, 4]),  # no swaps
    ):
        game = one_step([0, 1, 4], actions, collisions="block")
        assert game.positions[0].tolist() == after
    game = one_step([0, 2, 4], [EAST, WEST, STAY], collisions="block")
    assert game.positions[0].tolist() == [0, 2, 4]  # no meeting
    game = one_step([2, 3], [EAST, STAY], collisions="block")
    assert game.positions[0].tolist() == [3, 3] and game.terminated[0]  # "cell": not solid
    game = one_step([0, 1, 3], [STAY, EAST, WEST], collisions="block", capture="surround")
    assert game.positions[0].tolist() == [0, 1, 3]  # chaser and evader are solid


def test_capture_comes_before_escape_and_before_the_end_of_time() -> None:
    game = one_step([1, 3], [EAST, WEST], exits=[2], max_steps=1)
    assert game.events[0].tolist() == [CAPTURED, WAS_CAPTURED] and game.terminated[0]
    game = one_step([0, 3], [EAST, WEST], exits=[2], max_steps=1)
    assert game.events[0].tolist() == [ESCAPED, ESCAPED]
    assert game.terminated[0] and not game.truncated[0] and game.active[0].tolist() == [1, 0]


def test_after_chasers_lets_an_evader_walk_into_a_chaser() -> None:
    for check, captured in (("each_move", True), ("after_chasers", False)):
        rules = {"move_order": "chasers_first", "capture_check": check}
        assert bool(one_step([1, 2], [STAY, WEST], **rules).terminated[0]) is captured


def test_touches_are_paid_once_a_round_and_beside_captures() -> None:
    rewards = {"chaser": Rewards(step=-1.0, capture=10.0, touch=0.25), "evader": Rewards()}
    for order in ("simultaneous", "chasers_first"):
        game = one_step([1, 2], [STAY, STAY], move_order=order, rewards=rewards)
        assert game.rewards[0].tolist() == [-0.75, 0.0]
        game = one_step([1, 2], [STAY, STAY], move_order=order, rewards=rewards, capture="adjacent")
        assert game.rewards[0].tolist() == [10.25, 0.0]
    game = one_step([1, 2], [STAY, STAY], move_order="turns", rewards=rewards)
    assert game.rewards[0].tolist() == [0.25, 0.0]
    game.step([[STAY, STAY]])
    assert game.rewards[0].tolist() == [-1.0, 0.0]


def test_turns_ignore_the_side_that_waits_and_count_rounds() -> None:
    game = one_step([0, 4], [EAST, WEST], move_order="turns", max_steps=2)
    assert game.positions[0].tolist() == [1, 4] and game.rewards[0].tolist() == [0.0, 0.0]
    game.step([[EAST, WEST]])
    assert game.positions[0].tolist() == [1, 3]
    assert game.rewards[0].tolist() == [np.float32(-0.1), 1.0]
    game.step([[STAY, STAY]])
    assert not game.truncated[0]
    game.step([[STAY, STAY]])
    assert game.truncated[0] and game.episode_lengths[0] == 4


# -- slips -----------------------------------------------------------------------------------------

SLIPPING: list[dict[str, Any]] = [
    {"slip": 0.3},
    {"slip": {"evader": 0.5}, "capture": "adjacent", "collisions": "block"},
    {
        "slip": {"chaser_0": 0.4, "evader": 0.2},
        "move_order": "chasers_first",
        "capture": "surround",
    },
    {"slip": 0.6, "move_order": "turns", "n_catch": 2},
    {"slip": 1.0, "exits": [1, 5], "collisions": "block"},
]


@pytest.mark.parametrize("settings", SLIPPING, ids=str)
def test_results_of_slips_have_the_defined_frequencies(settings: dict[str, Any]) -> None:
    """The joint distribution of all results of a step, so also the independence of agents."""
    games = 20_000
    task = Task(ROOM, 2, 1, stay_action=True, **settings)
    simulator, rules = Simulator(task, games, seed=11, auto_restart=False), Rulebook(task)
    for number, (cells, actions) in enumerate((([0, 8, 4], (2, 4, 0)), ([3, 1, 7], (1, 0, 4)))):
        if number and task.exits:
            cells = [3, 0, 7]
        simulator.place(cells)
        for _ in range(2 if task.move_order == "turns" else 1):
            before = rules.read(simulator)
            expected = Counter[Any]()
            for result, chance in rules.outcomes(before, actions).items():
                expected[result.state, result.events] += chance  # type: ignore[assignment]
            simulator.step(np.tile(actions, (games, 1)))
            seen = np.concatenate([simulator.positions, simulator.active, simulator.events], axis=1)
            found, counts = np.unique(seen, axis=0, return_counts=True)
            observed = {
                tuple(row): n for row, n in zip(found.tolist(), counts.tolist(), strict=True)
            }
            wanted = {
                (*state.cells, *map(int, state.active), *events): games * chance
                for (state, events), chance in expected.items()
            }
            assert observed.keys() <= wanted.keys()
            rows = [(observed.get(row, 0), share) for row, share in wanted.items()]
            assert chisquare(*np.array(rows).T).pvalue > 1e-4
            if task.move_order == "turns":  # go on from one state in all games
                simulator.place(cells)
                simulator.step(np.full((games, 3), 4))
                simulator.place(cells)
                break


def test_slips_and_exits_do_not_depend_on_the_batch() -> None:
    task = make_task("escape", maze="5x5", slip=0.3, max_steps=15, num_chasers=2)
    whole = play(Simulator(task, 6, seed=4), 40)
    assert_same(whole, 5, play(Simulator(task, 1, seed=4, first_game=5), 40), 0)
    assert_same(whole, 3, play(Simulator(task, 3, seed=4, first_game=2), 40), 1)


def test_slips_of_the_next_episode_by_game_and_agent() -> None:
    """With a slip of 1, an agent that stays moves; with 0 it does not."""
    task = Task(ROOM, 1, 1, stay_action=True, slip={"evader": 0.5}, max_steps=1)
    simulator = Simulator(task, 4)
    simulator.configure(slip=[0.0, 1.0, 0.0, 1.0], seat="evader")
    simulator.configure([0, 1], slip=1.0, seat="chaser_0")
    simulator.reset()
    start = simulator.positions.copy()
    simulator.auto_restart = False
    simulator.step(np.full((4, 2), 4))
    moved = (simulator.positions != start).tolist()
    assert moved == [[True, False], [True, True], [False, False], [False, True]]
    for wrong in (-0.1, 1.5, np.nan, [0.5, 0.5]):
        with pytest.raises(ValueError, match="slip"):
            simulator.configure(slip=wrong)
    with pytest.raises(ValueError, match="this task has no slips"):
        Simulator(make_task("chase")).configure(slip=0.1)


def test_scripted_agents_slip() -> None:
    """A chaser without randomness in a corridor moves back with half the chance of a slip."""
    task = Task(CORRIDOR, 1, 1, slip={"chaser": 0.4}, stay_action=True, max_steps=1)
    simulator = Simulator(task, 20_000, seed=2, auto_restart=False)
    simulator.place([1, 4])
    actions = np.zeros((simulator.num_games, 2), dtype=np.int32)
    simulator.act([AStarChaser(), AStarEvader()], actions)
    assert (actions[:, 0] == EAST).all()
    simulator.step(actions)
    back = int((simulator.positions[:, 0] == 0).sum())
    assert chisquare([back, 20_000 - back], [4000, 16_000]).pvalue > 1e-4


# -- starts ----------------------------------------------------------------------------------------


def test_drawn_exits_and_cells_are_uniform_over_all_valid_starts() -> None:
    task = Task(CORRIDOR, 1, 1, num_exits=2)
    simulator = Simulator(task, 30_000, seed=8)
    sets = np.sort(simulator.exits, axis=1)
    starts = Counter(map(tuple, np.concatenate([simulator.positions, sets], axis=1).tolist()))
    valid = [
        (chaser, evader, *pair)
        for chaser, evader in itertools.permutations(range(5), 2)
        for pair in itertools.combinations(range(5), 2)
        if evader not in pair
    ]
    assert starts.keys() <= set(valid)
    assert chisquare([starts[start] for start in valid]).pvalue > 1e-4


@pytest.mark.parametrize("exits", [{"num_exits": 3}, {"exits": [0, 4, 8]}], ids=str)
def test_no_evader_or_goal_starts_on_an_exit(exits: dict[str, Any]) -> None:
    task = Task(ROOM, 2, 2, num_goals=2, **exits)
    simulator = Simulator(task, 5000, seed=1)
    held = np.concatenate([simulator.positions[:, 2:], simulator.goals], axis=1)
    assert not (held[:, :, None] == simulator.exits[:, None]).any()
    chasers = simulator.positions[:, :2]
    assert (chasers[:, :, None] == simulator.exits[:, None]).any()  # they may
    assert (simulator.exits >= 0).all()
    assert all(len(set(row)) == 3 for row in simulator.exits.tolist())


def test_drawn_exits_avoid_marked_goals_and_evaders() -> None:
    marked = Maze.from_text("+-+-+-+-+-+-+\n|S   G   G  |\n+-+-+-+-+-+-+")
    goals = Task(marked, 1, 1, num_goals=2, num_exits=2, start="marks")
    evaders = Task(marked, 1, 2, num_exits=2, start="marks")
    for task in (goals, evaders):
        simulator = Simulator(task, 300)
        assert not np.isin(simulator.exits, marked.goal_marks).any()


def test_starts_with_as_many_goals_as_fit_are_found() -> None:
    simulator = Simulator(Task(ROOM, 2, 2, num_goals=3, exits=[0, 8]), 200)
    cells = np.concatenate([simulator.positions, simulator.goals], axis=1)
    assert all(len(set(row)) == 7 for row in cells.tolist())


def test_games_are_placed_with_exits() -> None:
    simulator = Simulator(Task(ROOM, 1, 1, num_exits=2), 2)
    simulator.place([0, 4], exits=[[1, 2], [8, 0]])
    assert simulator.exits.tolist() == [[1, 2], [8, 0]]
    fixed = Simulator(Task(ROOM, 1, 1, exits=[2, 6], num_goals=1))
    fixed.place([0, 4], goals=[5])
    assert fixed.exits.tolist() == [[2, 6]]
    wrong: list[tuple[Simulator, str, dict[str, Any]]] = [
        (simulator, "exits are missing; give cells for 2", {}),
        (simulator, "an evader starts on an exit", {"exits": [4, 5]}),
        (simulator, "different cells of the maze", {"exits": [5, 5]}),
        (simulator, "exits", {"exits": [5, 9]}),
        (simulator, "exits", {"exits": [-1, 5]}),
        (simulator, "exits of shape", {"exits": [1, 2, 3]}),
        (fixed, "are fixed: leave them out", {"goals": [5], "exits": [1, 2]}),
        (fixed, "a goal is on an exit", {"goals": [2]}),
    ]
    for simulated, message, arguments in wrong:
        before = simulated.positions.copy()
        with pytest.raises(ValueError, match=message):
            simulated.place([0, 4], **arguments)
        np.testing.assert_array_equal(simulated.positions, before)


def test_saved_states_hold_exits_and_slips() -> None:
    task = make_task("escape", maze="4x4-tree", slip=0.2, max_steps=12, stay_action=True)
    simulator = Simulator(task, 5, seed=3)
    play(simulator, 7)
    simulator.configure(slip=0.7)
    state = simulator.get_state()
    expected = play(simulator, 30)
    for saved in (state, pickle.loads(pickle.dumps(state)), copy.deepcopy(state)):
        again = Simulator(task, 5, seed=99)
        again.set_state(saved)
        assert_equal(vars(again.get_state()), vars(state))
        for moment, counterpart in zip(expected, play(again, 30), strict=True):
            # The results of the last episode before the state are not part of it.
            assert_equal(moment, counterpart, {"episode_lengths", "final"})


def test_states_without_options_are_restored_only_in_tasks_without() -> None:
    plain = Simulator(make_task("chase", maze="5x5"), 2)
    state = plain.get_state()
    assert not {"exits", "slip", "next_slip"} & vars(state).keys()
    plain.set_state(state)
    for settings in ({"num_exits": 2}, {"slip": 0.1}):
        other = Simulator(Task("5x5", 1, 1, **settings), 2)
        with pytest.raises(ValueError, match="does not match this simulator"):
            other.set_state(state)
    wrong = Simulator(Task("5x5", 1, 1, num_exits=2, slip=0.1), 2)
    for name, value in (("exits", 25), ("slip", 1.5), ("next_slip", -0.5), ("next_slip", 2.0)):
        state = wrong.get_state()
        getattr(state, name)[0] = value
        with pytest.raises(ValueError, match=name):
            wrong.set_state(state)


# -- bad input -------------------------------------------------------------------------------------

REFUSED: list[tuple[str, dict[str, Any]]] = [
    ("n_catch=3, but num_chasers=2", {"n_catch": 3}),
    ("n_catch", {"n_catch": 0}),
    ("surround' with n_catch=2", {"capture": "surround", "n_catch": 2}),
    ("capture", {"capture": "touch"}),
    ("captures need chasers", {"num_chasers": 0, "num_goals": 1, "capture": "surround"}),
    ("captures need chasers", {"num_chasers": 0, "num_goals": 1, "capture_check": "after_chasers"}),
    ("simultaneous", {"capture_check": "after_chasers"}),
    ("only evaders escape", {"num_evaders": 0, "num_runners": 1, "num_goals": 1, "exits": [0]}),
    ("only evaders escape", {"num_evaders": 0, "num_runners": 1, "num_goals": 1, "num_exits": 1}),
    ("give one of them", {"exits": [0], "num_exits": 1}),
    ("the cells of .* are 0 to 8", {"exits": [9]}),
    ("cell is given twice", {"exits": [1, 1]}),
    ("numbers of one or more cells", {"exits": []}),
    ("numbers of one or more cells", {"exits": [-1]}),
    ("numbers of one or more cells", {"exits": [1.5]}),
    ("numbers of one or more cells", {"exits": [True]}),
    ("numbers of one or more cells", {"exits": "a,b"}),
    ("need different cells", {"num_exits": 9}),
    ("need different cells", {"exits": list(range(9))}),
    ("need different cells", {"exits": [0, 1, 2, 3], "num_goals": 3}),
    ("num_exits", {"num_exits": -1}),
    ("collisions='block' with capture='cell'", {"collisions": "block", "n_catch": 2}),
    ("collisions", {"collisions": "soft"}),
    ("slip", {"slip": -0.1}),
    ("slip", {"slip": 1.1}),
    ("slip", {"slip": float("nan")}),
    ("slip", {"slip": "much"}),
    ("slip of evader", {"slip": {"evader": 2.0}}),
    ("slip of 'runner'", {"slip": {"runner": 0.1}}),
    ("slip of 'evader_1'", {"slip": {"evader_1": 0.1}}),
    ("give stay_action=True", {"move_order": "turns", "stay_action": False}),
    ("take turns", {"move_order": "turns", "num_chasers": 0, "num_goals": 1}),
    ("num_runners=1", {"move_order": "turns", "num_runners": 1, "num_goals": 1}),
    ("per_evader", {"rewards": "chaser.per_evader=true,chaser.touch=1"}),
    ("touch", {"rewards": "evader.touch=1"}),
    ("no random placement", {"exits": [0, 2, 4, 6, 8], "min_start_distance": 5}),
]  # fmt: skip


@pytest.mark.parametrize(("message", "settings"), REFUSED, ids=lambda v: str(v)[:40])
def test_contradictory_options_are_refused_in_one_line(
    message: str, settings: dict[str, Any]
) -> None:
    defaults = {"maze": ROOM, "num_chasers": 2, "num_evaders": 1, "stay_action": True}
    with pytest.raises(ValueError, match=message) as raised:
        Task(**{**defaults, **settings})
    assert "\n" not in str(raised.value)


def test_exits_on_marks_where_games_start_are_refused() -> None:
    marked = Maze.from_text("+-+-+-+-+\n|S   G E|\n+-+-+-+-+")
    assert Task(marked, 1, 1).fixed_exits == ((3,),)
    for settings, message in (
        ({"exits": [0], "start": "marks"}, "marked as start or goal"),
        ({"exits": [2], "start": "marks"}, "marked as start or goal"),
        ({"num_exits": 1}, "exits marked E"),
    ):
        with pytest.raises(ValueError, match=message):
            Task(marked, 1, 1, **settings)


@pytest.mark.parametrize("cell", [0, 2])
def test_with_random_starts_exits_may_be_on_marks(cell: int) -> None:
    """The marks have no effect then."""
    marked = Maze.from_text("+-+-+-+-+\n|S   G  |\n+-+-+-+-+")
    bare = Maze.from_text("+-+-+-+-+\n|       |\n+-+-+-+-+")
    games = [Simulator(Task(maze, 1, 1, exits=[cell]), 32, seed=1) for maze in (marked, bare)]
    rng = np.random.default_rng(0)
    for _ in range(40):
        actions = rng.integers(4, size=(32, 2))
        for simulator in games:
            simulator.step(actions)
        for name in ("positions", "active", "rewards", "terminated", "exits"):
            np.testing.assert_array_equal(*(getattr(simulator, name) for simulator in games))
        assert (games[0].exits == cell).all()
    heist = Task(marked, 1, 1, num_goals=1, exits=[cell])
    simulator = Simulator(heist, 32, seed=1)
    assert (simulator.goals != cell).all() and (simulator.positions[:, 1] != cell).all()


def test_slips_as_text_are_exact_and_name_each_role_once() -> None:
    for given in (0.1 + 0.2, 1 / 3, 1e-7, 0, {"evader": 1 / 7, "chaser_0": 0.0}):
        text = slip_text(given)
        assert check_slip("slip", text) == check_slip("slip", given)
    with pytest.raises(ValueError, match="given twice"):
        Task(ROOM, 1, 1, slip="evader=0.1,evader=0.2")


def test_exits_are_any_list_of_cells() -> None:
    for given in ([1, 5], (1, 5), np.array([1, 5]), range(1, 6, 4), "1,5"):
        assert Task(ROOM, 1, 1, exits=given).fixed_exits == ((1, 5),)  # type: ignore[arg-type]
