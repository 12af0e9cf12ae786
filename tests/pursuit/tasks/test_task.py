"""Task and Rewards: immutable, hashable, and checked at creation."""

import copy
import json
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pursuit import Maze, Rewards, Simulator, Task, load_maze, make_task
from pursuit.mazes.maze import library_names
from pursuit.tasks.task import TASK_NAMES

DUEL: dict[str, Any] = {"num_chasers": 1, "num_evaders": 1}
OWN = {"evader": Rewards(step=-0.5), "chaser": Rewards(capture=2.0)}
TASKS: dict[str, Callable[[], Task]] = {
    **{name: lambda name=name: make_task(name) for name in TASK_NAMES},  # type: ignore[misc]
    "own rewards": lambda: Task(**DUEL, rewards=OWN),
    "several mazes": lambda: Task(**DUEL, maze=["3x3", load_maze("5x5"), Path("4x4")][:2]),
}


@pytest.mark.parametrize("name", TASKS)
def test_equal_tasks_hash_alike_however_they_were_made(name: str) -> None:
    task, again = TASKS[name](), TASKS[name]()
    assert task == again and hash(task) == hash(again) and len({task, again}) == 1
    for copied in (
        copy.copy(task),
        copy.deepcopy(task),
        pickle.loads(pickle.dumps(task)),
        replace(task),
        Task(**{field.name: getattr(task, field.name) for field in fields(task)}),
    ):
        assert copied == task and hash(copied) == hash(task)
    other = replace(task, max_steps=7)
    assert other != task and other not in {task}


def test_the_order_of_rewards_does_not_count() -> None:
    backwards = dict(reversed(OWN.items()))
    one, other = Task(**DUEL, rewards=OWN), Task(**DUEL, rewards=backwards)
    assert one == other and hash(one) == hash(other)
    assert one != Task(**DUEL, rewards={**OWN, "evader": Rewards(step=-0.6)})


def test_tasks_do_not_share_mutable_arguments() -> None:
    rewards, mazes = dict(OWN), ["3x3", "5x5"]
    task = Task(**DUEL, rewards=rewards, maze=mazes)
    before = hash(task)
    rewards["evader"] = Rewards(step=9.0)
    rewards.clear()
    mazes.append("7x7")
    assert hash(task) == before and task.rewards == OWN and task.maze == ("3x3", "5x5")
    assert task.role_rewards["evader"] == OWN["evader"] and len(task.mazes) == 2
    assert task == Task(**DUEL, rewards=OWN, maze=(name for name in ("3x3", "5x5")))  # type: ignore[arg-type]


def test_a_task_never_changes() -> None:
    task = Task(**DUEL, rewards=OWN)
    with pytest.raises(FrozenInstanceError):
        task.max_steps = 3  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        task.role_rewards["evader"].step = 3.0  # type: ignore[misc]
    own: Any = task.rewards
    for kept in (own, task.role_rewards):
        with pytest.raises(TypeError, match="immutable"):
            kept["evader"] = Rewards()
        with pytest.raises(TypeError, match="immutable"):
            del kept["evader"]
        for change in (
            lambda d: d.update(evader=Rewards()),
            lambda d: d.clear(),
            lambda d: d.pop("evader"),
            lambda d: d.popitem(),
            lambda d: d.setdefault("runner", Rewards()),
            lambda d: d.__ior__({}),
        ):
            with pytest.raises(TypeError, match="immutable"):
                change(kept)
    assert task.rewards == OWN


def test_rewards_are_used_like_the_dict_that_was_given() -> None:
    task = Task(**DUEL, rewards=OWN)
    rewards: Any = task.rewards
    assert rewards == OWN and isinstance(rewards, dict) and list(rewards) == list(OWN)
    assert rewards["evader"].step == -0.5 and {**rewards} == OWN
    assert replace(task, rewards={**rewards, "chaser": Rewards()}).role_rewards["chaser"].step == 0
    plain = json.loads(json.dumps(asdict(task)))
    assert plain["rewards"]["evader"]["step"] == -0.5 and plain["num_chasers"] == 1


def test_whole_numbers_of_numpy_become_python_ones() -> None:
    task = Task(**DUEL, max_steps=np.int32(7), stay_action=np.True_)  # type: ignore[arg-type]
    assert type(task.max_steps) is int and type(task.stay_action) is bool
    assert task == Task(**DUEL, max_steps=7, stay_action=True)
    assert type(Rewards(step=np.float32(1)).step) is float  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"num_chasers": -1}, "num_chasers=-1; it is at least 0"),
        ({"max_steps": 0}, "max_steps=0; it is at least 1"),
        ({"max_steps": 2**31}, "max_steps=2147483648"),
        ({"num_goals": 1.0}, "num_goals=1.0; it is a whole number"),
        ({"num_evaders": 1.5}, r"num_evaders=1\.5; it is a whole number"),
        ({"stay_action": "no"}, "stay_action='no'; it is True or False"),
        (
            {"move_order": "evaders_first"},
            r"unknown move_order 'evaders_first' \(did .*\); one of simult",
        ),
        ({"start": "corner"}, "unknown start 'corner'; one of random, marks"),
        (
            {"rewards": "gold"},
            r"unknown rewards 'gold' \(did you mean 'goal'\?\); one of goal, completion",
        ),
        ({"rewards": {"hunter": Rewards()}}, r"rewards for \['hunter'\]; the roles are chaser"),
        ({"rewards": {"evader": 1.0}}, r"rewards of the evader: 1.0; give pursuit.Rewards"),
        ({"maze": []}, "maze: an empty list; give at least one maze"),
        ({"maze": 5}, "maze=5; give the name of a maze, a path, a Maze, or several"),
    ],
)
def test_fields_are_checked_as_they_are_declared(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Task(**{**DUEL, **settings})
    with pytest.raises(ValueError, match=message):
        make_task("chase", **settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step": float("nan")}, "step=nan; it is finite"),
        ({"goal": "1"}, "goal='1'; it is a number"),
        ({"capture": True}, "capture=True; it is a number"),
        ({"on_completion": 1}, "on_completion=1; it is True or False"),
    ],
)
def test_rewards_are_finite_numbers(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Rewards(**settings)


@given(st.sampled_from(library_names()), st.text(min_size=1))
def test_equal_mazes_hash_alike_whatever_their_names(maze: str, name: str) -> None:
    one, other = load_maze(maze), Maze.from_text(load_maze(maze).to_text(), name=name)
    assert one == other and hash(one) == hash(other)
    assert Task(**DUEL, maze=one) == Task(**DUEL, maze=other)
    assert hash(Task(**DUEL, maze=one)) == hash(Task(**DUEL, maze=other))


def test_equal_mazes_are_compared_without_their_text(monkeypatch: pytest.MonkeyPatch) -> None:
    maze, other = load_maze("5x5"), load_maze("5x5")
    monkeypatch.setattr(Maze, "to_text", None)
    assert maze == other and hash(maze) == hash(other) and maze is not other
    assert maze != load_maze("5x5-tree") and maze != "5x5"


@pytest.mark.parametrize("field", ["step", "capture", "goal", "distance"])
def test_rewards_are_finite_in_float32(field: str) -> None:
    for value in (1e31, -1e308, 10**40):
        with pytest.raises(
            ValueError, match=rf"{field}=.*rewards are float32: give at most 1e\+30"
        ):
            Rewards(**{field: value})
    largest = {role: Rewards(**{field: -1e30}) for role in ("chaser", "evader", "runner")}
    task = Task(maze="9x9", num_chasers=2, num_evaders=2, num_goals=2, rewards=largest)
    simulator = Simulator(task, 50, seed=0)
    for _ in range(20):
        simulator.step(np.random.default_rng(0).integers(0, 4, (50, 4)))
        assert np.isfinite(simulator.rewards).all()
