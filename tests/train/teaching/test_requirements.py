"""Which curricula a task allows, and which errors are raised before a run starts."""

from __future__ import annotations

import warnings
from dataclasses import asdict, replace
from itertools import pairwise
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_teaching import CHASE, MAZE

from train.commands.main import main
from train.runs.parts import settings_of
from train.settings.curricula import ScheduleSettings
from train.settings.presets import TaskProfile, curriculum_for, hyperparameters
from train.teaching.mazes import first_rows, opened
from train.teaching.plan import training_task


def test_mazes_of_a_curriculum_agree_with_the_last_one() -> None:
    settings = settings_of(**{**MAZE, "maze": "7x7"}, curriculum="maze-size")
    mazes = training_task("maze-size", settings.curriculum_settings, settings.task.build()).mazes
    final = mazes[-1]
    assert final == settings.task.build().mazes[0] and len(mazes) >= 4
    sizes = [maze.num_cells for maze in mazes]
    assert sizes == sorted(sizes)
    for maze in mazes[:-1]:
        inner = np.arange(maze.num_cells - maze.width)
        # Cells keep their numbers and neighbours, but for the last row, which has a wall below.
        assert (maze.neighbors[inner] == final.neighbors[inner]).all()
    walls = [m.num_loops for m in (opened(final, s) for s in (0.0, 0.3, 0.6, 1.0))]
    assert walls == sorted(walls) and len(set(walls)) == 4
    assert opened(final, 0.0) == final and opened(final, 1.0).longest_distance == 12
    assert first_rows(final, 1, 100) is None


@pytest.mark.parametrize(
    ("flat", "message"),
    [
        ({**CHASE, "curriculum": "goal-spread-start"}, "needs goals, which task 'chase'"),
        ({**MAZE, "curriculum": "opponent-epsilon"}, "needs opponents, all of them scripted"),
        ({**MAZE, "curriculum": "start-distance"}, "needs chasers and evaders"),
        ({**MAZE, "num_goals": 1, "curriculum": "num-goals"}, "needs at least 2 goals"),
        ({**MAZE, "curriculum": "easy-first"}, "unknown curriculum 'easy-first'"),
        ({**MAZE, "curriculum": "uniform", "axis": "speed"}, "unknown axis 'speed'"),
        ({**MAZE, "curriculum": "uniform", "num_stages": 1}, "num_stages=1"),
        ({**MAZE, "curriculum": "uniform", "window": 3}, "unknown setting 'window'"),
        ({**CHASE, "curriculum": "opponent-epsilon", "easiest": 1.5}, "epsilon=1.5"),
        (
            {**CHASE, "curriculum": "opponent-epsilon", "easiest": 0.1,
             "schedule": "exponential", "schedule_unit": "episodes"},
            "end 0.2 is above the start 0.1",
        ),
        ({**MAZE, "curriculum": "goal-spread-start", "schedule_length": -0.1}, "at least 0"),
        ({**MAZE, "curriculum": "goal-spread-start", "schedule": "step"}, "more than the budget"),
        ({**MAZE, "curriculum": "uniform", "easiest": float("inf")}, "a finite number"),
        ({**MAZE, "curriculum": "reversed", "schedule_unit": "frames"}, "less than 1"),
        ({**CHASE, "curriculum": "opponent-epsilon", "schedule": "piecewise",
          "schedule_points": "0:1,0.5:2"}, "epsilon=2.0"),
        ({**MAZE, "curriculum": "goal-spread-start", "easiest": 0.5}, "whole number of steps"),
        ({**MAZE, "start": "marks", "curriculum": "goal-spread-start"}, "needs random starts"),
        ({**MAZE, "start": "marks", "curriculum": "level-replay"}, "replays random starts"),
        (
            {**MAZE, "algorithm": "q_learning", "curriculum": "maze-size"},
            "q_learning needs a single",
        ),
        (
            {**MAZE, "algorithm": "reinforce", "curriculum": "level-replay",
             "level_score": "value_loss"},
            "needs advantages",
        ),
        (
            {**CHASE, "num_chasers": 2, "curriculum": "level-replay"},
            "needs the exact optimum of every start",
        ),
        (
            {**MAZE, "curriculum": "maze-size", "curriculum_mazes": "3x3, 9x9"},
            "9x9 is larger than the task's maze 5x5",
        ),
        ({**MAZE, "curriculum": "maze-size", "curriculum_mazes": "nowhere"}, "unknown maze"),
        (
            {**MAZE, "curriculum": "success-gated", "solved_within": 0.5},
            "solved_within=0.5",
        ),
        ({**MAZE, "curriculum": "goal-spread-start", "schedule": "piecewise",
          "schedule_points": "0:1;1:2"}, "progress:value pairs"),
        ({**MAZE, "curriculum": "goal-spread-start", "schedule": "piecewise",
          "schedule_points": "0:1,0.5:nan"}, "give finite numbers"),
        ({**MAZE, "curriculum": "shuffled", "schedule_unit": "frames",
          "schedule_length": inf}, "schedule_length=inf"),
        ({**MAZE, "curriculum": "success-gated", "hardest": nan}, "a finite number"),
        ({**MAZE, "curriculum": "success-gated", "solved_within": inf}, "solved_within=inf"),
    ],
)  # fmt: skip
def test_what_cannot_be_taught_is_said_at_once(flat: dict[str, Any], message: str) -> None:
    if "algorithm" in flat:
        flat = {k: v for k, v in flat.items() if k != "minibatch_size"}
    with pytest.raises(ValueError, match=message):
        settings_of(**flat)


def test_a_spread_beyond_the_maze_is_clipped_and_says_so() -> None:
    with pytest.warns(
        UserWarning,
        match="40 steps is more than the largest distance in maze 5x5; it is clipped to 10",
    ):
        settings_of(**MAZE, curriculum="goal-spread-start", hardest=40.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        settings_of(**{**MAZE, "frames": 60_000}, curriculum="goal-spread-start", hardest=10.0)


def test_large_mazes_have_a_curriculum_unless_told_otherwise() -> None:
    large = settings_of(**{**MAZE, "maze": "9x9"})
    assert large.curriculum == "goal-spread-start"
    assert settings_of(**{**MAZE, "maze": "9x9"}, curriculum="none").curriculum == "none"
    assert settings_of(**MAZE).curriculum == "none"
    with pytest.raises(ValueError, match="give UniformSettings"):
        replace(large, curriculum="uniform")


@pytest.mark.parametrize(("task", "role"), [("maze", "runner"), ("chase", "chaser")])
@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "dqn"])
def test_settings_change_smoothly_with_the_size_of_the_maze(
    task: str, role: str, algorithm: str
) -> None:
    found = []
    for cells in range(4, 400):
        setting = TaskProfile(task, role, cells, duel=True)
        curriculum, curriculum_settings = curriculum_for(algorithm, setting)
        length = (
            curriculum_settings.schedule_length
            if isinstance(curriculum_settings, ScheduleSettings)
            else 0.0
        )
        assert curriculum == "none" or cells > 25
        hyper = asdict(hyperparameters(algorithm, setting))
        numbers = {k: float(v) for k, v in hyper.items() if isinstance(v, int | float)}
        found.append(numbers | {"horizon": 1 / (1 - numbers["gamma"]), "length": length})
    for one, larger in pairwise(found):
        for name, value in one.items():
            step = 256 if name in ("num_games", "minibatch_size") else 0.15 * abs(value) + 0.012
            assert abs(larger[name] - value) <= 2 * step, name
    changed = {name for name in found[0] if found[0][name] != found[-1][name]}
    assert {"length", *(["gamma"] if role == "chaser" else [])} <= changed
    assert found[-1]["length"] == {"runner": 0.5, "chaser": 0.2}[role]


def test_options_are_checked_together_and_warnings_are_heard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = "--frames 1024 --num-games 64 --minibatch-size 256 --threads 1 --episodes 5 --maze 3x3"
    common += " --no-report"
    main(
        f"train --task race {common} --curriculum level-replay --level-score learnability "
        f"--out {tmp_path / 'race'}".split()
    )
    capsys.readouterr()
    main(
        f"train --task maze {common} --curriculum goal-spread-start --hardest 40 "
        f"--out {tmp_path / 'maze'}".split()
    )
    said = capsys.readouterr().err
    assert said.count("40 steps is more than the largest distance in maze 3x3; it is clipped") == 1
