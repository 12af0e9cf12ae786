"""Curricula over mazes: exact scores, and hard mazes played more."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from curricula import Outcomes, PoolReplay
from pursuit.tasks.task import make_task
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner, RandomAgent
from train.evaluation.suite_contest import SuiteContest
from train.kinds import start
from train.runs.folder import RUN
from train.runs.parts import parts_of, settings_of
from train.runs.worlds import task_world_of
from train.teaching.plan import plan_curriculum
from train.teaching.regret import RegretScorer

NOBODY = Outcomes(*(np.zeros(0) for _ in range(6)))  # type: ignore[arg-type]


def judge(pool: PoolReplay, scores: np.ndarray[Any, Any], rng: np.random.Generator) -> list[int]:
    chosen = pool.to_score(rng)
    pool.note(chosen, scores[chosen])
    return list(chosen)


def test_every_level_is_judged_before_any_is_judged_again() -> None:
    pool, rng = PoolReplay(20, num_scored=5), np.random.default_rng(0)
    scores = np.arange(20.0)
    seen = [level for _ in range(4) for level in judge(pool, scores, rng)]
    assert sorted(seen) == list(range(20))
    assert set(judge(pool, scores, rng)) == set(seen[:5])  # the oldest


def test_hard_levels_are_replayed_by_rank_and_the_rest_is_uniform() -> None:
    pool, rng = PoolReplay(10, 10, replay_share=0.5, staleness=0.0), np.random.default_rng(1)
    assert set(pool.sample(2000, rng)) == set(range(10))  # nothing is scored yet
    judge(pool, np.arange(10.0), rng)
    ranks = np.arange(10, 0, -1.0) ** (-1 / 0.3)
    expected = 0.5 / 10 + 0.5 * ranks / ranks.sum()
    drawn = np.bincount(pool.sample(200_000, rng).astype(int), minlength=10) / 200_000
    assert drawn == pytest.approx(expected, abs=0.005)


def test_the_pool_goes_on_from_its_state() -> None:
    pool, rng = PoolReplay(8, 4), np.random.default_rng(3)
    for _ in range(4):
        judge(pool, np.linspace(1, 2, 8), rng)
    copy = PoolReplay(8, 4)
    copy.load_state_dict(pool.state_dict())
    first, second = np.random.default_rng(4), np.random.default_rng(4)
    assert (pool.sample(50, first) == copy.sample(50, second)).all()
    assert (pool.to_score(first) == copy.to_score(second)).all()
    with pytest.raises(ValueError, match="scores of 8 levels, and this pool has 2"):
        PoolReplay(2).load_state_dict(pool.state_dict())
    with pytest.raises(ValueError, match="scored_at of 6 levels, and this pool has 8"):
        copy.load_state_dict({**pool.state_dict(), "scored_at": np.zeros(6, dtype=np.int64)})


@pytest.mark.parametrize(
    ("changed", "rule"),
    [
        ({"levels": 0}, "at least 1 level"),
        ({"num_scored": 0}, "at least 1 level"),
        ({"replay_share": 1.5}, "in \\[0, 1\\]"),
        ({"temperature": 0.0}, "above 0"),
    ],
)
def test_other_pools_are_refused(changed: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        PoolReplay(**{"levels": 2, **changed})
    with pytest.raises(ValueError, match="give numbers of at least 0"):
        PoolReplay(1).note(np.array([0]), np.array([np.nan]))


@pytest.mark.parametrize(
    ("name", "agent", "opponents", "policy", "more"),
    [
        ("maze", "runner", {}, RandomAgent(), {"num_goals": 1}),
        ("chase", "chaser", {"evader": AStarEvader(0.2)}, AStarChaser(0.1), {}),
        ("chase", "evader", {"chaser": AStarChaser(0.2)}, AStarEvader(0.0), {}),
    ],
)
def test_marks_are_the_gaps_of_the_exact_contest(
    name: str, agent: str, opponents: Any, policy: Any, more: Any
) -> None:
    task = make_task(name, maze="suite:5x5-train/0-5", max_steps=50, **more)
    contest = SuiteContest(task, agent, opponents, exact=True)
    found, best = contest.in_mazes("learned", policy), contest.best
    assert best is not None
    gaps = np.abs(found.steps / best.steps - 1.0)
    scorer = RegretScorer(task, agent, opponents)
    chosen = np.array([4, 1, 0])
    assert scorer.scores(policy, chosen) == pytest.approx(gaps[chosen])
    learnable = RegretScorer(task, agent, opponents, "learnability").scores(policy, chosen)
    assert (learnable <= 0.25).all()
    # p(1 - p) is largest where success is even, and a mean of it is at most that of the mean.
    assert (learnable <= found.success[chosen] * (1 - found.success[chosen]) + 1e-9).all()


def test_the_optimal_runner_has_no_regret_and_nothing_to_learn() -> None:
    task = make_task("maze", maze="suite:5x5-train/0-5", num_goals=1)
    for mark in ("regret", "learnability"):
        marks = RegretScorer(task, "runner", {}, mark).scores(NearestGoalRunner(), np.arange(6))
        assert marks == pytest.approx(0.0, abs=1e-9)


def test_exact_scores_need_games_that_are_solved() -> None:
    task = make_task("maze", maze="suite:5x5-train/0-5", num_goals=2)
    with pytest.raises(
        ValueError, match="use curriculum level-replay or learnability, or num_goals=1"
    ):
        RegretScorer(task, "runner", {})
    settings = settings_of(task="maze", num_goals=1, maze="5x5", frames=1000)
    one = task_world_of(settings.task).context
    settings = settings_of(**SMALL, curriculum="maze-replay").curriculum_settings
    with pytest.raises(ValueError, match="chooses among mazes, and task 'maze' has one"):
        plan_curriculum("maze-replay", settings, one, 0)


SMALL: dict[str, Any] = {
    "task": "maze",
    "num_goals": 1,
    "maze": "suite:5x5-train/0-9",
    "observation": "planes",
    "max_steps": 20,
    "frames": 2000,
    "num_games": 64,
    "rollout_steps": 4,
    "minibatch_size": 128,
    "width": 8,
}


def test_a_run_judges_its_mazes_and_plays_the_hard_ones(tmp_path: Path) -> None:
    settings = settings_of(**SMALL, curriculum="maze-learnability", score_every=250, num_scored=4)
    run = start(RUN, settings, tmp_path / "run")
    run.train()
    teacher = run.trainee.teacher
    pool = teacher.curriculum
    assert pool.rounds >= 7 and (pool.scores[:10] >= 0).all()
    assert run.trainee.simulator.task.mazes == run.trainee.contest.task.mazes
    assert "lesson" not in run.rows[-1] and teacher.rows
    exact = teacher.scorer.scores(teacher.scored_policy, np.arange(10))
    assert np.isfinite(exact).all()


@pytest.mark.parametrize("memory", [{"recurrent": "gru"}, {"frame_stack": 3}])
def test_a_memory_is_refused_before_anything_is_made(memory: dict[str, Any]) -> None:
    flat = {"task": "maze", "maze": "suite:5x5-train/0-3", "num_goals": 1, "frames": 1000}
    with pytest.raises(ValueError, match="leave out recurrent and frame_stack"):
        parts_of(settings_of(**flat, curriculum="maze-replay", **memory))


def test_former_names_of_settings_are_refused_with_the_new_ones() -> None:
    for old, new in (("judged", "num_scored"), ("judge_every", "score_every")):
        with pytest.raises(ValueError, match=f"unknown setting {old!r}.*; give {new}"):
            settings_of(**SMALL, curriculum="maze-replay", **{old: 4})
