"""Encodings: each lies in its space and equals a plain construction from the state."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from tests.reference_observations import Seen

HOLES = Maze.from_text(
    "+-+-+-+-+\n|   |   |\n+ +-+ + +\n| |#|   |\n+ +-+ + +\n|       |\n+-+-+-+-+"
)
TASKS = {
    "1v1": make_task("chase", maze="3x3", max_steps=20),
    "2v3": Task(maze=HOLES, num_chasers=2, num_evaders=3, max_steps=20),
    "maze": Task(maze=HOLES, num_runners=1, num_goals=4, max_steps=20),
    "race": Task(maze="3x3", num_runners=3, num_goals=3, max_steps=20),
    "heist": Task(maze="3x3", num_chasers=1, num_evaders=2, num_goals=2, max_steps=20),
    "all, in two mazes": Task(
        maze=("5x5", HOLES), num_chasers=2, num_evaders=2, num_runners=2, num_goals=2, max_steps=20
    ),
}


def played(task: Task, games: int = 24, steps: int = 40) -> Any:
    """A simulator in each of the states that random play comes through."""
    simulator = Simulator(task, games, seed=1, auto_restart=False)
    rng = np.random.default_rng(2)
    for _ in range(steps):
        yield simulator
        simulator.reset(games=simulator.ended)
        simulator.step(rng.integers(task.num_actions, size=(games, task.num_agents)))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", TASKS)
def test_observations_are_those_of_the_plain_construction(name: str, encoding: str) -> None:
    gone = collected = 0
    for simulator in played(TASKS[name], games=8, steps=30):
        observed = simulator.observe(encoding)
        for game in range(simulator.num_games):
            for seat in range(simulator.num_agents):
                seen = Seen(simulator, game, seat)
                gone += None in seen.entities
                collected += seen.collected
                expected = getattr(seen, encoding)()
                assert observed[game, seat].dtype == expected.dtype
                np.testing.assert_array_equal(observed[game, seat], expected)
    assert gone > 0  # captures or collected goals were among them
    assert collected > 0 or not TASKS[name].num_goals


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", TASKS)
def test_observations_lie_in_their_space(name: str, encoding: str) -> None:
    for simulator in played(TASKS[name], games=5):
        encoder = simulator.encoder(encoding)
        for own in simulator.observe(encoding).reshape(-1, *encoder.shape):
            assert encoder.space.contains(own)
    assert simulator.encoder(encoding).space is encoder.space


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_one_agent_and_given_arrays_have_the_same_observations(encoding: str) -> None:
    *_, simulator = played(TASKS["all, in two mazes"])
    every = simulator.observe(encoding)
    for seat, name in enumerate(simulator.task.agent_names):
        np.testing.assert_array_equal(simulator.observe(encoding, seat), every[:, seat])
        np.testing.assert_array_equal(simulator.observe(encoding, name), every[:, seat])
    out = np.full_like(every, 1)
    assert simulator.observe(encoding, out=out) is out
    np.testing.assert_array_equal(out, every)
    out = np.full_like(every, 1)
    for seat in range(simulator.num_agents):
        simulator.observe(encoding, seat, out=out[:, seat])  # not contiguous
    np.testing.assert_array_equal(out, every)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_array_that_does_not_fit_is_refused(encoding: str) -> None:
    *_, simulator = played(TASKS["race"])
    every = simulator.observe(encoding)
    for out in (every[1:], every[..., :-1], every.astype(np.float64)):
        with pytest.raises(ValueError, match="out of shape"):
            simulator.observe(encoding, out=out.copy())


@pytest.mark.parametrize("name", TASKS)
def test_index_scattered_is_one_hot(name: str) -> None:
    for simulator in played(TASKS[name], steps=20):
        one_hot, index = simulator.observe("one_hot"), simulator.observe("index")
        size = one_hot.shape[-1]
        scattered = np.zeros((*index.shape[:2], size + 1), dtype=np.float32)
        np.put_along_axis(scattered, index.astype(np.int64), 1.0, axis=-1)
        np.testing.assert_array_equal(scattered[..., :size], one_hot)


@pytest.mark.parametrize("name", TASKS)
def test_an_embedding_bag_of_index_is_a_linear_layer_of_one_hot(name: str) -> None:
    *_, simulator = played(TASKS[name])
    one_hot = torch.from_numpy(simulator.observe("one_hot")).flatten(0, 1).double()
    index = torch.from_numpy(simulator.observe("index")).flatten(0, 1).long()
    size = one_hot.shape[-1]
    torch.manual_seed(0)
    linear = torch.nn.Linear(size, 16, bias=False, dtype=torch.float64)
    bag = torch.nn.EmbeddingBag(size + 1, 16, mode="sum", padding_idx=size, dtype=torch.float64)
    with torch.no_grad():
        bag.weight[:size] = linear.weight.T
    torch.testing.assert_close(bag(index), linear(one_hot))


def test_an_unknown_encoding_is_named() -> None:
    with pytest.raises(ValueError, match=r"unknown observation 'onehot' .*; one of one_hot"):
        Simulator(TASKS["1v1"]).observe("onehot")
