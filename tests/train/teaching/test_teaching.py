"""Curricula in training: what they say is what is played, for every learner; and it resumes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from game_rows import rows_of

from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import AStarChaser, best_response, tour_lengths
from train.commands.main import main
from train.evaluation.games import won_by
from train.files import read_csv
from train.kinds import start
from train.runs.folder import RUN, load_checkpoint
from train.runs.loop import Run, build_run
from train.runs.opponents import load_policy
from train.runs.parts import parts_of, settings_of
from train.runs.saved import load_settings
from train.runs.single import single_agent
from train.settings.axes import AXES as AXIS_NAMES
from train.settings.curricula import CURRICULA, CurriculumSettings
from train.teaching.axes import AXIS_MAKERS
from train.teaching.teacher import CURRICULUM_LOG, Teacher

QUICK = {"num_games": 64, "minibatch_size": 256, "threads": 1, "frames": 20_000}
MAZE = {"task": "maze", "maze": "5x5", "num_goals": 3, **QUICK}
CHASE = {"task": "chase", "maze": "5x5", **QUICK}


@pytest.fixture(autouse=True)
def few_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations take most of the time of runs as short as these."""
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 5)


def teacher_of(run: Run) -> Teacher:
    assert run.trainee.teacher is not None
    return run.trainee.teacher


def watch_restarts(run: Run, look: Any) -> None:
    """Have `look(teacher, games)` called after every restart, with the games that begin anew."""
    teacher = teacher_of(run)
    after_restart = teacher.after_restart

    def spied(games: Any) -> None:
        after_restart(games)
        look(teacher, games)

    teacher.after_restart = spied  # type: ignore[method-assign]


@pytest.mark.slow
def test_the_opponents_share_of_random_moves_follows_the_schedule(tmp_path: Path) -> None:
    # The thesis set epsilon on the learner, which ignores it: its opponent was never annealed.
    settings = settings_of(
        **{**CHASE, "role": "evader", "frames": 60_000, "opponent_epsilon": 0.2},
        curriculum="opponent-epsilon",
        schedule_length=0.8,
    )
    run = start(RUN, settings, tmp_path)
    simulator, maze = run.trainee.simulator, run.trainee.simulator.task.mazes[0]
    greedy = AStarChaser(0.0).action_probabilities(maze) > 0
    moves = maze.neighbors[:, :4] != np.arange(maze.num_cells)[:, None]
    step, seen = simulator.step, []

    def spied(actions: Any) -> None:
        chaser, evader = simulator.positions.T.copy()
        allowed, best = moves[chaser], greedy[chaser, evader]
        off = ~best[np.arange(len(chaser)), actions[:, 0]]
        chance = 1.0 - (allowed & best).sum(axis=1) / allowed.sum(axis=1)
        stages = (teacher_of(run).playing * chance).sum()
        seen.append((run.progress, off.sum(), chance.sum(), stages))
        step(actions)

    simulator.step = spied  # type: ignore[method-assign]
    run.train()
    progress, off, chance, stages = np.array(seen).T
    for begin, end in ((0.0, 0.1), (0.3, 0.5), (0.6, 0.7), (0.85, 1.01)):
        here = (progress >= begin) & (progress < end)
        measured = off[here].sum() / chance[here].sum()
        noise = 3.0 / chance[here].sum() ** 0.5
        assert measured == pytest.approx(stages[here].sum() / chance[here].sum(), abs=noise)
    assert off[progress < 0.1].sum() / chance[progress < 0.1].sum() > 0.85
    late = progress > 0.9
    assert off[late].sum() / chance[late].sum() == pytest.approx(0.2, abs=0.06)


def spread_fixed(simulator: Simulator, game: int, value: float) -> None:
    maze = simulator.task.mazes[0]
    nearest = np.min([maze.distances_from(mark) for mark in maze.goal_marks], axis=0)
    # Where fewer cells are that near than there are goals, the radius grows until they fit.
    if value >= 2:
        assert nearest[simulator.goals[game]].max() <= value


def spread_start(simulator: Simulator, game: int, value: float) -> None:
    far = simulator.task.mazes[0].distances[simulator.positions[game, 0], simulator.goals[game]]
    assert far.max() <= value


def start_distance(simulator: Simulator, game: int, value: float) -> None:
    chaser, evader = simulator.positions[game]
    assert simulator.task.mazes[0].distances[chaser, evader] <= value


def num_goals(simulator: Simulator, game: int, value: float) -> None:
    assert (simulator.goals[game] >= 0).sum() == value


def maze_number(simulator: Simulator, game: int, value: float) -> None:
    assert simulator.maze_index[game] == value


def epsilon(simulator: Simulator, game: int, value: float) -> None:
    assert simulator.epsilon[game, 1] == value


AXES = {
    "goal-spread-fixed": (MAZE, spread_fixed),
    "goal-spread-start": (MAZE, spread_start),
    "start-distance": (CHASE, start_distance),
    "num-goals": (MAZE, num_goals),
    "maze-size": (MAZE, maze_number),
    "loops": (MAZE, maze_number),
    "opponent-epsilon": (CHASE, epsilon),
}


def test_every_axis_and_curriculum_that_can_be_named_can_be_made() -> None:
    assert set(AXIS_MAKERS) == set(AXIS_NAMES)
    without = {form for form in CURRICULA.values() if form.build is CurriculumSettings.build}
    assert without == {CURRICULA["none"]}


SLOW_AXES = set(AXES) - {"opponent-epsilon", "goal-spread-start"}
"""An axis of each end of the game is looked at each time; `make test-all` looks at all."""


@pytest.mark.parametrize(
    "axis",
    [pytest.param(axis, marks=[pytest.mark.slow] * (axis in SLOW_AXES)) for axis in AXES],
)
def test_every_axis_turns_what_it_says_up_to_the_task_itself(axis: str, tmp_path: Path) -> None:
    flat, holds = AXES[axis]
    run = start(RUN, settings_of(**flat, curriculum=axis, schedule_length=0.6), tmp_path)
    values = []

    def look(teacher: Teacher, games: Any) -> None:
        for game in games:
            values.append(float(teacher.playing[game]))
            holds(run.trainee.simulator, int(game), values[-1])

    watch_restarts(run, look)
    run.train()
    found = teacher_of(run).axis
    assert found is not None
    assert values[-1] == found.hardest and found.easiest != found.hardest
    assert len(set(values)) >= 3
    # What stands in the log is what was given, and the log ends at the task itself.
    log = read_csv(tmp_path / CURRICULUM_LOG)
    assert float(log[0]["mean"]) == found.easiest
    assert float(log[-1]["mean"]) == found.hardest
    assert all(row["reason"].startswith("linear schedule at") for row in log)


def test_two_shuffled_stages_are_warned_of() -> None:
    given = {**MAZE, "curriculum": "shuffled", "axis": "num-goals"}
    with pytest.warns(UserWarning, match="'shuffled' has two stages, so half of the seeds"):
        settings_of(**{**given, "num_goals": 2})


@pytest.mark.parametrize(
    "name",
    [
        "uniform",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("learning-progress", "success-gated", "shuffled")
        ),
    ],
)
def test_stages_lie_on_the_axis_and_the_last_is_the_task(name: str, tmp_path: Path) -> None:
    more = {"window": 100} if name == "success-gated" else {}
    settings = settings_of(**MAZE, curriculum=name, axis="num-goals", **more)
    run = start(RUN, settings, tmp_path)
    seen: set[float] = set()
    watch_restarts(run, lambda teacher, games: seen.update(teacher.playing[games].tolist()))
    run.train()
    assert seen <= {1.0, 2.0, 3.0} and len(seen) >= (1 if name == "success-gated" else 3)
    assert run.trainee.contest.task.num_goals == 3  # evaluated at the final difficulty, always
    assert {"stage", "on_hardest", "training_success"} <= set(run.rows[-1])
    assert all(0.0 <= row.get("on_hardest", 0.0) <= 1.0 for row in run.rows)


def test_the_share_of_the_hardest_stage_counts_frames_not_episodes(tmp_path: Path) -> None:
    settings = settings_of(**MAZE, curriculum="uniform", axis="num-goals")
    teacher = start(RUN, settings, tmp_path).trainee.teacher
    hard, easy = teacher.axis.hardest, teacher.axis.easiest
    teacher._played = [np.array([[hard, easy], [20.0, 2.0]]), np.array([[hard, easy], [18.0, 0.0]])]
    teacher._won = [np.ones(4, dtype=bool)]
    saved = teacher.state_dict()
    assert teacher.figures()["on_hardest"] == pytest.approx(38 / 40)
    teacher.load_state_dict(saved)
    assert teacher.figures()["on_hardest"] == pytest.approx(38 / 40)


@pytest.mark.parametrize(
    ("algorithm", "curriculum"),
    [
        ("a2c", "level-replay"),
        ("reinforce", "goal-spread-start"),
        pytest.param("dqn", "level-replay", marks=pytest.mark.slow),
        pytest.param("q_learning", "goal-spread-start", marks=pytest.mark.slow),
    ],
)
def test_every_learner_can_be_taught(algorithm: str, curriculum: str, tmp_path: Path) -> None:
    small = {"batch_size": 64, "learning_starts": 100} if algorithm == "dqn" else {}
    settings = settings_of(
        task="maze", maze="3x3", num_goals=2, frames=10_000, num_games=64, threads=1,
        algorithm=algorithm, curriculum=curriculum, **small,
    )  # fmt: skip
    run = start(RUN, settings, tmp_path)
    run.train()
    assert teacher_of(run).episodes > 100


def test_a_level_is_played_again_exactly() -> None:
    task = make_task("heist", maze="7x7")
    first, second = Simulator(task, 5, seed=1), Simulator(task, 8, seed=2)
    for simulator, games in ((first, None), (second, np.array([7, 2, 3, 0, 5]))):
        simulator.reset()
        simulator.seed_starts(games, [11, 12, 13, 11, 2**53 - 1])
        simulator.reset()
    one, other = rows_of(first), rows_of(second)[[7, 2, 3, 0, 5]]
    assert (one == other).all() and (one[0] == one[3]).all() and (one[0] != one[1]).any()
    for wrong in ([-1], [0.5], [1, 2]):
        with pytest.raises(ValueError):
            first.seed_starts(np.array([0, 1, 2]), wrong)


def test_the_regret_of_an_episode_is_against_the_optimum_of_its_own_start(tmp_path: Path) -> None:
    for flat in (MAZE, {**CHASE, "role": "chaser"}, {**CHASE, "role": "evader"}):
        run = start(
            RUN, settings_of(**flat, curriculum="level-replay"), tmp_path / flat.get("role", "x")
        )
        simulator, teacher = run.trainee.simulator, teacher_of(run)
        maze, seat = simulator.task.mazes[0], run.trainee.env.seat
        run.trainee.env.restart()
        positions, goals = simulator.positions.copy(), simulator.goals.copy()
        if flat is MAZE:
            best: Any = tour_lengths(maze, positions[:, 0], goals)
        else:
            role = str(flat["role"])
            table = run.trainee.parts.world.opponents["evader" if role == "chaser" else "chaser"]
            probabilities = table.action_probabilities(maze)  # type: ignore[attr-defined]
            values = best_response(role, maze, probabilities, horizon=200).values  # type: ignore[arg-type]
            best = values[positions[:, 0], positions[:, 1]]
        rng, ended = np.random.default_rng(0), np.zeros(simulator.num_games, dtype=bool)
        actions = np.zeros((simulator.num_games, simulator.num_agents), dtype=np.int32)
        while not ended.any():
            simulator.act(run.trainee.env.policies, actions)
            actions[:, seat] = rng.integers(0, 4, simulator.num_games)
            simulator.step(actions)
            ended = simulator.terminated | simulator.truncated
        teacher.episode_ended(ended)
        state = teacher.state_dict()
        values, _, _, lengths, regrets = (part.numpy() for part in state["outcomes"][-1])
        share = lengths / best[ended]
        wanted = 1 - share if flat.get("role") == "evader" else share - 1
        assert regrets == pytest.approx(np.maximum(wanted, 0))
        assert (values == teacher.playing[ended]).all()


def test_positive_advantages_belong_to_their_episodes(tmp_path: Path) -> None:
    flat = {**MAZE, "curriculum": "level-replay", "level_score": "value_loss"}
    run = start(RUN, settings_of(**flat), tmp_path)
    teacher, rng = teacher_of(run), np.random.default_rng(0)
    sums: dict[int, list[float]] = {game: [] for game in range(64)}
    wanted = []
    for _ in range(4):
        advantages, done = rng.standard_normal((64, 16)), rng.random((64, 16)) < 0.1
        teacher.note_advantages(advantages, done)  # type: ignore[arg-type]
        for step in range(16):
            for game in range(64):
                sums[game].append(max(advantages[game, step], 0.0))
                if done[game, step]:
                    wanted.append(np.mean(sums[game]))
                    sums[game] = []
    assert np.concatenate(teacher._errors) == pytest.approx(wanted)


@pytest.mark.parametrize(
    "sampled",
    [["3", "3"], [3 + 0j, 3], [3.0], [[3.0], [3.0]], [float("nan"), 3.0], None, 3.0, "33"],
    ids=repr,
)
def test_samples_of_a_curriculum_are_finite_numbers(tmp_path: Path, sampled: Any) -> None:
    run = start(RUN, settings_of(**CHASE, curriculum="start-distance"), tmp_path)
    teacher, games = teacher_of(run), np.arange(2)
    before = teacher.simulator.get_state().next_max_start_distance.copy()
    teacher.curriculum.sample = lambda num_games, rng: sampled  # type: ignore[method-assign]
    with pytest.raises(ValueError, match=r"values=.*return 2 finite numbers, one for each game"):
        teacher.before_restart(games)
    after = teacher.simulator.get_state().next_max_start_distance
    np.testing.assert_array_equal(after, before)
    teacher.curriculum.sample = lambda num_games, rng: [3, 3]  # type: ignore
    teacher.before_restart(games)


def test_a_checkpoint_of_another_curriculum_is_refused(tmp_path: Path) -> None:
    small = {**MAZE, "maze": "3x3", "frames": 8192}
    settings = settings_of(**small, curriculum="uniform")
    start(RUN, settings, tmp_path).train(lambda run, row: setattr(run, "stopped", True))
    before = (tmp_path / "checkpoint.pt").read_bytes()
    other = settings_of(**small, curriculum="learning-progress")
    with pytest.raises(ValueError, match="checkpoint has curriculum 'uniform'"):
        build_run(single_agent, parts_of(other), tmp_path, load_checkpoint(tmp_path))
    assert (tmp_path / "checkpoint.pt").read_bytes() == before


def test_a_policy_taught_on_several_mazes_is_evaluated_on_the_last(tmp_path: Path) -> None:
    settings = settings_of(**CHASE, curriculum="loops")
    run = start(RUN, settings, tmp_path)
    run.train()
    assert run.results(50)["evaluation"]["exact"]
    maze = run.trainee.contest.task.mazes[0]
    table = load_policy(tmp_path).action_probabilities(maze)  # type: ignore[attr-defined]
    assert (table == run.trainee.policy.action_probabilities(maze)).all()  # type: ignore[attr-defined]
    assert len(run.trainee.simulator.task.mazes) > 1 and load_settings(tmp_path) == settings


def test_a_chaser_wins_by_catching_not_by_the_loss_of_all_goals() -> None:
    task = make_task("heist", maze="3x3", num_goals=1, max_steps=50)
    simulator = Simulator(task, 1, auto_restart=False)
    move = int(np.flatnonzero(task.mazes[0].neighbors[0, :4] != 0)[0])
    simulator.place([[8, 0]], [[task.mazes[0].neighbors[0, move]]])
    simulator.step([[0, move]])
    assert simulator.terminated[0] and simulator.goals[0, 0] < 0
    assert not won_by(simulator, 0)[0] and won_by(simulator, 1)[0]


def test_the_command_line_teaches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "run"
    options = "--task maze --maze 3x3 --frames 8192 --num-games 64 --minibatch-size 256"
    rest = "--threads 1 --curriculum level-replay --level-buffer 50 --episodes 20"
    main(["train", *options.split(), *rest.split(), "--out", str(folder)])
    told = capsys.readouterr().out
    assert "curriculum: level-replay, over levels" in told
    assert (folder / "learning_curve.png").stat().st_size > 10_000
    assert "mean regret" in read_csv(folder / CURRICULUM_LOG)[-1]["reason"]
    with pytest.raises(SystemExit):
        main(["train", "--curriculum", "uniform", "--help-all"])
    assert "--num-stages" in capsys.readouterr().out
