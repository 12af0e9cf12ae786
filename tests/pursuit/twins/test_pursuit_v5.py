"""PettingZoo's `pursuit_v5` and the same game here: equal moves, captures, rewards, observations.

Both play the same actions, those of its own random evaders included, from the same cells. Its
rewards are computed from our states, the events of captures and the reward `touch` of our step, and
paid by the rewards "pursuit_v5".
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from pettingzoo.sisl import pursuit_v5

from pursuit.mazes.maze import Maze
from pursuit.observations.pursuit_v5 import PURSUIT_V5_ACTIONS, PursuitV5Observation
from pursuit.rules.layout import CAPTURED
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.pursuit_v5 import PursuitV5Rewards
from pursuit.tasks.rewards import REWARDS
from pursuit.tasks.task import Rewards, Task
from train.networks.policy import MazeSeat
from train.settings.presets import preset_task
from train.settings.task import TaskSettings

PURSUERS, EVADERS, WIDTH, HEIGHT = 6, 6, 8, 7
TAG, CATCH, URGENCY = 0.01, 5.0, -0.1  # its defaults
EPISODE = 4  # then all agents get new cells


class Recorded:
    """The policy of its evaders, which notes what it draws."""

    def __init__(self, policy: Any) -> None:
        self.policy, self.drawn = policy, []

    def act(self, state: Any) -> Any:
        self.drawn.append(self.policy.act(state))
        return self.drawn[-1]


class Twins(NamedTuple):
    """The parallel environment, its inner game, the recorded evaders, our game with rewards for
    touched evaders, and the same game with the rewards "pursuit_v5"."""

    env: Any
    base: Any
    evaders: Recorded
    ours: Simulator
    paying: Simulator


def twins(surround: bool, obstacle: bool, shared: bool, obs_range: int = 7) -> Twins:
    env = pursuit_v5.parallel_env(
        x_size=WIDTH, y_size=HEIGHT, n_pursuers=PURSUERS, n_evaders=EVADERS, surround=surround,
        n_catch=2, max_cycles=10**9, shared_reward=shared, obs_range=obs_range,
    )  # fmt: skip
    env.reset(seed=1)
    base = env.unwrapped.env
    if not obstacle:
        base.map_matrix[:] = 0  # all its agents share this array
    walkable = base.map_matrix.T == 0  # its arrays are [x, y], ours [row, column]
    open_south = np.ones((HEIGHT - 1, WIDTH), dtype=bool)
    open_east = np.ones((HEIGHT, WIDTH - 1), dtype=bool)
    task = Task(
        Maze(walkable, open_south, open_east),
        num_chasers=PURSUERS,
        num_evaders=EVADERS,
        stay_action=True,
        move_order="chasers_first",
        capture_check="after_chasers",
        capture="surround" if surround else "cell",
        n_catch=1 if surround else 2,
        max_steps=10**9,
        rewards=PursuitV5Rewards(TAG, CATCH, URGENCY, shared),
    )
    return paired(env, task)


def paired(env: Any, task: Task) -> Twins:
    """The twins of an environment and our task, whose rewards are those of pursuit_v5."""
    base = env.unwrapped.env
    base.evader_controller = Recorded(base.evader_controller)
    touched = replace(task, rewards={"chaser": Rewards(touch=1.0)})  # their number is the reward
    games = [Simulator(each, seed=1, auto_restart=False) for each in (touched, task)]
    return Twins(env, base, base.evader_controller, games[0], games[1])


def place(game: Twins, rng: np.random.Generator) -> None:
    """Start an episode of both with agents in random cells, which they may share; four pursuers
    stand around an evader, as captures would be rare otherwise."""
    env, base, _, ours, paying = game
    env.reset()
    ours.reset()
    paying.reset()
    maze, pursuers = ours.task.mazes[0], ours.task.num_chasers
    cells = rng.integers(maze.num_cells, size=ours.task.num_agents)
    cells[rng.permutation(pursuers)[:4]] = maze.neighbors[rng.choice(cells[pursuers:]), :4]
    ours.positions[0] = paying.positions[0] = cells
    agents = [*base.pursuer_layer.allies, *base.evader_layer.allies]
    for agent, cell in zip(agents, cells, strict=True):
        agent.set_position(maze.columns[cell], maze.rows[cell])
    base.model_state[0] = base.map_matrix
    base.model_state[1] = base.pursuer_layer.get_state_matrix()
    base.model_state[2] = base.evader_layer.get_state_matrix()


def cells_of(layer: Any, maze: Maze) -> list[int]:
    places = [layer.get_position(i) for i in range(layer.n_agents())]
    return [int(maze.cell_numbers[y, x]) for x, y in places]


def counted(maze: Maze, cells: NDArray[np.int32], evaders: NDArray[np.int32]) -> NDArray[Any]:
    """[2, cells]: the evaders one move away from each cell, and those that the tag reward adds.

    A neighbor beyond the border is the cell itself there, so evaders in it count once for each side
    of the border that it touches.
    """
    beside = maze.neighbors[cells, :4]
    moves = beside != cells[:, None]
    touched = ((beside[:, :, None] == evaders) & moves[:, :, None]).sum(axis=(1, 2))
    rows, columns = maze.rows[cells], maze.columns[cells]
    sides = (rows == 0) * 1 + (rows == maze.height - 1)
    sides += (columns == 0) * 1 + (columns == maze.width - 1)
    return np.stack([touched, sides * (cells[:, None] == evaders).sum(axis=1)])


def play(game: Twins, steps: int, shared: bool) -> tuple[int, int]:
    """Play and compare; return the numbers of captures and of captors."""
    env, base, recorded, ours, paying = game
    maze, rng = ours.task.mazes[0], np.random.default_rng(5)
    pursuers, evaders = ours.task.num_chasers, ours.task.num_evaders
    names = env.possible_agents
    seen = PursuitV5Observation(base.obs_range)
    moves = np.array(PURSUIT_V5_ACTIONS)
    captures = captors = 0
    waited = np.arange(pursuers)  # of its `pursuers` rewards, those before the pursuer's own move
    for step in range(steps):
        if step % EPISODE == 0 or not env.agents:
            place(game, rng)
        free = ours.active[0, pursuers:] != 0
        before = ours.positions[0].copy()
        actions = rng.choice(5, size=pursuers, p=[0.1, 0.1, 0.1, 0.1, 0.6])
        recorded.drawn.clear()
        observed, rewards, terminated, *_ = env.step(
            dict(zip(names, actions.tolist(), strict=True))
        )
        gone = base.evaders_gone.copy()
        chosen = np.full(evaders, 4)  # what captured evaders choose has no effect
        chosen[~gone] = recorded.drawn
        for simulator in (ours, paying):
            simulator.step(moves[np.concatenate([actions, chosen])][None])

        after = ours.positions[0]
        assert cells_of(base.pursuer_layer, maze) == after[:pursuers].tolist()
        assert cells_of(base.evader_layer, maze) == after[pursuers:][~gone].tolist()
        np.testing.assert_array_equal(gone, ours.active[0, pursuers:] == 0)
        assert terminated[names[0]] == ours.terminated[0] == gone.all()

        stood = before[pursuers:][free]
        past, now = counted(maze, before[:pursuers], stood), counted(maze, after[:pursuers], stood)
        np.testing.assert_array_equal(ours.rewards[0, :pursuers], now[0])
        tags = waited * past.sum(axis=0) + (pursuers - waited) * now.sum(axis=0)
        caught = (ours.events[0, :pursuers] & CAPTURED) != 0
        paid = TAG * tags / pursuers + CATCH * caught + URGENCY
        paid = np.full(pursuers, paid.mean()) if shared else paid
        np.testing.assert_allclose([rewards[name] for name in names], paid, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(paying.rewards[0, :pursuers], paid.astype(np.float32))
        captures += int((free & gone).sum())
        captors += int(caught.sum())

        own = ours.observe(seen)[0, :pursuers]  # type: ignore[arg-type]
        np.testing.assert_array_equal(own, [observed[name] for name in names])
        if gone.all():
            env.agents.clear()
    return captures, captors


@pytest.mark.parametrize(
    ("surround", "obstacle", "shared", "steps"),
    [
        (True, True, True, 500),
        (False, False, False, 500),
        pytest.param(True, False, False, 2000, marks=pytest.mark.slow),
        pytest.param(False, True, True, 2000, marks=pytest.mark.slow),
    ],
)
def test_the_same_actions_give_the_same_game(
    surround: bool, obstacle: bool, shared: bool, steps: int
) -> None:
    captures, captors = play(twins(surround, obstacle, shared), steps, shared)
    assert captures > steps / 100
    assert captors > captures / 2


@pytest.mark.parametrize("obs_range", [1, 5, 15])
def test_windows_of_any_odd_size_are_equal(obs_range: int) -> None:
    play(twins(True, True, True, obs_range), 20, shared=True)


def test_the_preset_is_the_default_game_with_own_rewards() -> None:
    task = TaskSettings(**preset_task("sisl-pursuit", TaskSettings)).build()
    game = paired(pursuit_v5.parallel_env(shared_reward=False), task)
    game.env.reset(seed=1)
    assert game.base.max_cycles == task.max_steps
    np.testing.assert_array_equal(game.base.map_matrix.T == 0, task.mazes[0].cell_numbers >= 0)
    captures, _ = play(game, 100, shared=False)
    assert captures > 0


def test_the_named_rewards_are_the_default_ones_with_and_without_sharing() -> None:
    assert REWARDS.get("pursuit_v5") == PursuitV5Rewards(TAG, CATCH, URGENCY, shared=True)
    assert REWARDS.get("pursuit_v5_local") == PursuitV5Rewards(TAG, CATCH, URGENCY, shared=False)


def test_rewards_need_rows_and_columns() -> None:
    with pytest.raises(ValueError, match=r"'pursuit_v5' need the rows .* roads-8x8"):
        Simulator(Task("roads-8x8", num_chasers=1, num_evaders=1, rewards="pursuit_v5"))


def test_the_space_is_that_of_the_original() -> None:
    game = twins(True, True, True)
    expected = game.env.observation_space("pursuer_0")
    assert game.ours.encoder("pursuit_v5").space == expected
    first = PursuitV5Observation(channels_first=True)
    last = game.ours.observe("pursuit_v5")
    turned = game.ours.observe(first)  # type: ignore[arg-type]
    np.testing.assert_array_equal(turned, np.moveaxis(last, -1, 2))


def test_flat_windows_are_the_same_numbers_and_are_not_scaled() -> None:
    game = twins(True, True, True).ours
    windows, flat = (game.observe(name) for name in ("pursuit_v5", "pursuit_v5_flat"))
    np.testing.assert_array_equal(flat, windows.reshape(*windows.shape[:2], -1))
    most = max(game.task.num_chasers, game.task.num_evaders)
    for encoding, scale in (("pursuit_v5", most), ("pursuit_v5_flat", 1.0)):
        features = MazeSeat(game.task, "chaser", encoding, network="mlp").features
        assert (features.high == scale).all()


def test_an_even_window_and_a_graph_are_refused() -> None:
    with pytest.raises(ValueError, match="obs_range=6"):
        PursuitV5Observation(6)
    task = Task("roads-8x8", num_chasers=1, num_evaders=1)
    with pytest.raises(ValueError, match="is a graph"):
        Simulator(task).observe("pursuit_v5")
