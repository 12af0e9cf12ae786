"""What a run is made of is built once: the check of its settings hands its parts to the run."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from self_play_runs import make_settings
from test_resumption import tiny

from pursuit.tasks.task import Task
from train.commands.main import main
from train.experiments.executors import perform
from train.kinds import start, write_config
from train.runs import opponents
from train.runs.folder import RESULTS, RUN, SELF_PLAY
from train.settings.task import _built_once

TINY = "--maze 3x3 --frames 1024 --num-games 16 --minibatch-size 64 --threads 1 --episodes 4"


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> Counter[Task]:
    """The tasks that are constructed, equal ones together."""
    found: Counter[Task] = Counter()
    check = Task.__post_init__

    def count(task: Task) -> None:
        check(task)
        found[task] += 1

    monkeypatch.setattr(Task, "__post_init__", count)
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 1)
    _built_once.cache_clear()
    return found


def test_pursuit_train_builds_its_task_and_the_short_one_of_its_dry_run(
    built: Counter[Task], tmp_path: Path
) -> None:
    main(["train", *TINY.split(), "--out", str(tmp_path / "run")])
    assert {task.max_steps: number for task, number in built.items()} == {200: 1, 2: 1}


def test_a_run_of_a_sweep_builds_them_too(built: Counter[Task], tmp_path: Path) -> None:
    settings = tiny("ppo", maze="3x3", max_steps=20)
    (tmp_path / "run").mkdir()
    write_config(RUN, settings, tmp_path / "run")
    _built_once.cache_clear()
    built.clear()
    perform(tmp_path / "run")
    assert (tmp_path / "run" / RESULTS).exists()
    assert {task.max_steps: number for task, number in built.items()} == {20: 1, 2: 1}


def test_self_play_builds_each_of_its_tasks_once(built: Counter[Task], tmp_path: Path) -> None:
    """The game, with short episodes for training, and with shorter ones for the dry run."""
    settings = make_settings(frames=500, task={"max_steps": 30})
    _built_once.cache_clear()
    built.clear()
    run = start(SELF_PLAY, settings, tmp_path / "pair")
    assert {task.max_steps: number for task, number in built.items()} == {30: 1, 20: 1}
    run.train()
    own = {task.max_steps: n for task, n in built.items() if task.name == "chase"}
    assert own == {30: 1, 20: 1, 2: 1}


def test_a_learned_opponent_is_loaded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start(RUN, tiny("ppo", maze="3x3", max_steps=20), tmp_path / "first").train()
    settings = tiny(
        "ppo", maze="3x3", max_steps=20, role="evader", opponent=str(tmp_path / "first")
    )
    loaded = []
    load = opponents.load_policy
    monkeypatch.setattr(opponents, "load_policy", lambda *a: loaded.append(a) or load(*a))
    start(RUN, settings, tmp_path / "second")
    assert len(loaded) == 1
