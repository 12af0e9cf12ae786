"""Stopped and killed runs end bitwise equal to uninterrupted ones.

This is tested for every learner, curriculum and sampling rule of the registries.
"""

from __future__ import annotations

import contextlib
import math
import signal
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from itertools import cycle
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from self_play_runs import side_by
from tensorboard.backend.event_processing.event_multiplexer import EventMultiplexer

from train.algorithms.registry import ALGORITHMS, entry
from train.kinds import resume, start
from train.runs.folder import (
    RESULTS,
    RUN,
    SELF_PLAY,
    kept_policies,
    load_checkpoint,
    load_config,
    read_kept_list,
    read_metrics,
    sha256_in,
)
from train.runs.interruption import Stopped
from train.runs.loop import Run
from train.runs.parts import settings_of
from train.runs.threads import random_states, set_random_states
from train.self_play.parts import self_play_settings_of
from train.settings.algorithms import HYPERPARAMETERS
from train.settings.curricula import CURRICULA
from train.settings.self_play import (
    NASH_SAMPLING,
    OPPOSING_ROLES,
    SAMPLING,
    LearningSide,
    SelfPlaySettings,
    self_play_ppo,
)
from train.settings.task import TaskSettings

TIMING = {"seconds", "frames_per_second"}
TINY = {
    "num_games": 24, "rollout_steps": 3, "minibatch_size": 64, "width": 8, "population": 4,
    "elite_share": 0.5, "batch_size": 16, "buffer_size": 400, "learning_starts": 100,
    "gradient_steps": 2, "target_update_interval": 3, "epochs": 1,
}  # fmt: skip
OTHERS = [name for name in ALGORITHMS if entry(name).settings.SELF_PLAY_ONLY]
SINGLE = [name for name in ALGORITHMS if name not in (*OTHERS, "tracked")]
TAUGHT = [name for name in SINGLE if not entry(name).own_loop]
RUNNER = {"task": "maze", "maze": "3x3", "num_goals": 2, "max_steps": 12}
CHASER = {"task": "chase", "maze": "3x3", "max_steps": 12}
SUITE = {
    "task": "maze",
    "num_goals": 1,
    "maze": "suite:5x5-train/0-9",
    "observation": "planes",
    "max_steps": 12,
    "score_every": 200,
}
ARM = {"task": "reacher", "joints": 2, "max_steps": 12}
FRAMES = 900
LONGER = {"q_learning": 6000}
"""Where an iteration takes more frames than most: each run has to have several."""


@pytest.fixture(autouse=True)
def few_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces evaluations, which are not tested here and would take most of the time."""
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 4)
    monkeypatch.setattr("train.runs.single.EPISODES", 10)


class KilledError(Exception):
    """Ends a run between two checkpoints, as SIGKILL does."""


def carry_on(run: Run, until: float, end: Callable[[Run], object]) -> None:
    """Train, and do `end` in the first iteration beyond `until`."""

    def report(run: Run, row: dict[str, float]) -> None:
        if not row and until < run.progress < 1.0:
            end(run)

    run.train(report)


def stop_in(run: Run, place: str, progress: float) -> None:
    """Train, and send a signal in the first iteration or evaluation from this progress on: the run
    saves without evaluating, and `Stopped` is raised."""
    trainee: Any = run.trainee
    work, evaluate, evaluated = getattr(trainee, place), trainee.evaluate, []

    def interrupted(*given: Any) -> Any:
        if run.progress >= progress:
            evaluated.clear()
            signal.raise_signal(signal.SIGTERM)
        return work(*given)

    trainee.evaluate = lambda *how: evaluated.append(run.progress) or evaluate(*how)
    setattr(trainee, place, interrupted)
    with pytest.raises(Stopped) as stopped:
        run.train()
    assert stopped.value.status == 143 and not evaluated
    assert run.saved_frames == trainee.frames and progress <= run.progress < 1.0
    assert not (run.folder / RESULTS).exists()


def kill(run: Run) -> None:
    raise KilledError


def check_resumption(kind: str, settings: Any, folder: Path) -> None:
    """An uninterrupted run, and one that is stopped in an iteration and in an evaluation, and
    killed at 60 % of its budget."""
    whole, parts = folder / "whole", folder / "parts"
    start(kind, settings, whole).train()
    stop_in(start(kind, settings, parts), "iterate", 0.2)
    stop_in(resume(parts, kind), "evaluate", 0.5)
    with pytest.raises(KilledError):
        carry_on(resume(parts, kind), 0.6, kill)
    resume(parts, kind).train()
    check_same_runs(whole, parts)


def check_same_runs(whole: Path, parts: Path) -> None:
    """Checkpoints, metrics, TensorBoard events and snapshots are equal."""
    check_same(load_checkpoint(whole), load_checkpoint(parts), "checkpoint")
    check_same(read_metrics(whole), read_metrics(parts), "metrics")
    check_same(points_in(whole), points_in(parts), "TensorBoard")
    assert read_kept_list(whole).best == read_kept_list(parts).best is not None
    assert len(read_kept_list(parts).kept) >= 3
    snapshots = [
        sorted([*path.glob("pool/*/*.pt"), *path.glob("**/checkpoints/*/*.pt")])
        for path in (whole, parts)
    ]
    assert [p.relative_to(whole) for p in snapshots[0]] == [
        p.relative_to(parts) for p in snapshots[1]
    ]
    for one, two in zip(*snapshots, strict=True):
        check_same(torch.load(one), torch.load(two), one.name)


def points_in(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """All points of the TensorBoard events in a folder: frames and values by name."""
    events = EventMultiplexer().AddRunsFromDirectory(str(folder)).Reload()
    found: dict[str, list[tuple[int, float]]] = {}
    for run, content in events.Runs().items():
        for name in content["scalars"]:
            points = [(point.step, point.value) for point in events.Scalars(run, name)]
            found[name] = sorted(found.get(name, []) + points)
    return found


def check_same(one: Any, two: Any, place: str) -> None:
    """The contents of two checkpoints without their times."""
    assert type(one) is type(two), place
    if isinstance(one, dict):
        assert set(one) == set(two), place
        for name in set(one) - TIMING:
            check_same(one[name], two[name], f"{place}.{name}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(two), place
        for number, (a, b) in enumerate(zip(one, two, strict=True)):
            check_same(a, b, f"{place}[{number}]")
    elif isinstance(one, torch.Tensor):
        equal = torch.allclose(one, two, rtol=0, atol=0, equal_nan=True)
        assert one.dtype == two.dtype and one.shape == two.shape and equal, place
    else:
        assert one == two or (one != one and two != two), f"{place}: {one!r} and {two!r}"


def smallest(algorithm: str) -> dict[str, Any]:
    """The values of TINY that an algorithm has."""
    names = {field.name for field in fields(HYPERPARAMETERS[algorithm])}
    return {name: value for name, value in TINY.items() if name in names}


def tiny(algorithm: str, **flat: Any) -> Any:
    """Settings of a short run, small in whatever the algorithm has."""
    return settings_of(
        **{
            **smallest(algorithm),
            "algorithm": algorithm,
            "threads": 1,
            "checkpoints": 3,
            "frames": LONGER.get(algorithm, FRAMES),
            "curriculum": "none",
            **flat,
        }
    )


@pytest.mark.parametrize("algorithm", SINGLE)
def test_every_learner_resumes(algorithm: str, tmp_path: Path) -> None:
    game = RUNNER if "discrete" in ALGORITHMS[algorithm].actions else ARM
    check_resumption(RUN, tiny(algorithm, **game), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "flat",
    [
        {"algorithm": "ppo", "kl_target": 0.01, "shared": False},
        {"algorithm": "a2c", "critic": False},
        {"algorithm": "dqn", "prioritized": True, "dueling": True},
        {"algorithm": "dqn", "mask_bumps": True},
        {"algorithm": "td3", "prioritized": True, "noise": "ornstein-uhlenbeck", **ARM},
        {"algorithm": "cross_entropy", "observation": "planes"},
        {"algorithm": "cross_entropy", "frame_stack": 2, **CHASER},
        {"algorithm": "q_learning", "role": "evader", **CHASER},
        {"algorithm": "ppo", "recurrent": "gru", **CHASER},
        {"algorithm": "ppo", "recurrent": "gru", "shared": False},
        {"algorithm": "a2c", "recurrent": "gru", "mask_bumps": True},
        {"algorithm": "ppo", "frame_stack": 3, "observation": "planes"},
        {"algorithm": "dqn", "frame_stack": 2},
    ],
    ids=lambda flat: " ".join(map(str, flat.values())),
)
def test_switched_learners_resume(flat: dict[str, Any], tmp_path: Path) -> None:
    game = {} if "joints" in flat else RUNNER
    check_resumption(RUN, tiny(**{**game, **flat}), tmp_path)


def test_a_learner_resumes_against_a_recurrent_opponent(tmp_path: Path) -> None:
    evader = start(RUN, tiny("ppo", role="evader", recurrent="gru", **CHASER), tmp_path / "evader")
    evader.train()
    check_resumption(RUN, tiny("ppo", opponent=str(tmp_path / "evader"), **CHASER), tmp_path)


@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "reinforce", "cross_entropy"])
def test_learners_of_both_kinds_of_actions_resume_on_an_arm(algorithm: str, tmp_path: Path) -> None:
    check_resumption(RUN, tiny(algorithm, **ARM), tmp_path)


def test_learners_of_discrete_actions_resume_on_an_arm(tmp_path: Path) -> None:
    check_resumption(RUN, tiny("dqn", **ARM, discrete_actions=True), tmp_path)


def taught(algorithm: str, curriculum: str, **flat: Any) -> Any:
    """A run with a curriculum: of a runner; of a chaser or an arm where that has not what turns."""
    for game in (RUNNER, CHASER, SUITE, {**CHASER, "slip": "0.2"}):
        with contextlib.suppress(ValueError):
            return tiny(algorithm, curriculum=curriculum, **game, **flat)
    return tiny(algorithm, curriculum=curriculum, **ARM, hold=3, **flat)


@pytest.mark.slow
@pytest.mark.parametrize(
    "curriculum",
    [pytest.param(name, marks=[pytest.mark.slow] * name.startswith("maze-")) for name in CURRICULA],
)
def test_every_curriculum_resumes(curriculum: str, tmp_path: Path) -> None:
    check_resumption(RUN, taught("ppo", curriculum), tmp_path)


def test_games_with_exits_slips_and_turns_resume(tmp_path: Path) -> None:
    turns = {"move_order": "turns", "stay_action": True, "slip": "0.2"}
    check_resumption(RUN, tiny("ppo", **{**CHASER, "task": "escape", **turns}), tmp_path)


def test_levels_scored_by_advantages_resume(tmp_path: Path) -> None:
    check_resumption(RUN, taught("a2c", "level-replay", level_score="value_loss"), tmp_path)


@pytest.mark.parametrize("number, algorithm", enumerate(TAUGHT))
def test_every_learner_resumes_with_a_curriculum(
    number: int, algorithm: str, tmp_path: Path
) -> None:
    """A diagonal through learners and curricula: the states of both are saved separately, and the
    tests above resume each of them alone."""
    names = list(CURRICULA)[1:]
    for curriculum in names[2 * number :] + names[: 2 * number]:
        with contextlib.suppress(ValueError):  # the learner or its game does not support it
            settings = taught(algorithm, curriculum)
            break
    check_resumption(RUN, settings, tmp_path)


# -- self-play -------------------------------------------------------------------------------------

PPO = replace(self_play_ppo(), num_games=24, rollout_steps=3, minibatch_size=64, width=8)


def both(task: dict[str, Any] | None = None, **changes: Any) -> SelfPlaySettings:
    """Settings of a short self-play with more snapshots than most pools keep."""
    game = {"maze": "3x3", "rewards": "zero_sum", "max_steps": 12, **(task or {})}
    sides = dict.fromkeys(OPPOSING_ROLES, LearningSide(hyper=changes.pop("hyper", PPO)))
    given = {
        **sides,
        "frames": 2 * FRAMES,
        "snapshots": 7,
        "pool_size": 3,
        "checkpoints": 3,
        **({"window": 2} if changes.get("sampling") == "window" else {}),
        **changes,
    }
    return SelfPlaySettings(task=TaskSettings(**game), **given)


@pytest.mark.slow
@pytest.mark.parametrize("sampling", SAMPLING)
def test_every_scheme_of_self_play_resumes(sampling: str, tmp_path: Path) -> None:
    size = 7 if sampling in NASH_SAMPLING else 3
    settings = both(sampling=sampling, members=("astar",), pool_size=size)
    check_resumption(SELF_PLAY, settings, tmp_path)


@pytest.mark.parametrize("sampling", ["latest", "uniform"])
def test_a_self_play_killed_before_its_first_iteration_resumes(
    sampling: str, tmp_path: Path
) -> None:
    def after_the_first_evaluation(run: Run, row: dict[str, float]) -> None:
        raise KilledError

    settings = both(sampling=sampling, members=("astar",) if sampling == "uniform" else ())
    start(SELF_PLAY, settings, tmp_path / "whole").train()
    with pytest.raises(KilledError):
        start(SELF_PLAY, settings, tmp_path / "parts").train(after_the_first_evaluation)
    resume(tmp_path / "parts", SELF_PLAY).train()
    check_same_runs(tmp_path / "whole", tmp_path / "parts")


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", OTHERS)
def test_every_learner_of_self_play_resumes(algorithm: str, tmp_path: Path) -> None:
    side = LearningSide(algorithm, entry(algorithm).settings(**smallest(algorithm)))
    roles: Any = dict.fromkeys(OPPOSING_ROLES, side)
    check_resumption(SELF_PLAY, both(**roles, sampling="uniform"), tmp_path)


def test_runs_in_small_games_resume(tmp_path: Path) -> None:
    """With masks, chance, turns, and three players; the opponents change by a curriculum."""
    game = {"game": "trained_games:Stones(num_players=3)", "player": "b", "observation": "one_hot"}
    check_resumption(RUN, tiny("ppo", curriculum="opponent-epsilon", **game), tmp_path / "single")
    sides = {"b": {"algorithm": "dqn"}, "c": "uniform", "members": ("uniform",)}
    given = {**TINY, "frames": FRAMES, "snapshots": 4, "sampling": "pfsp", "threads": 1, **sides}
    given["checkpoints"] = 3
    known = {name: given[name] for name in given if name not in ("population", "elite_share")}
    settings = self_play_settings_of(game="trained_games:Crowd", **known)
    check_resumption(SELF_PLAY, settings, tmp_path / "play")


@pytest.mark.slow
@pytest.mark.parametrize(
    "algorithm, sampling",
    zip([name for name in ALGORITHMS if entry(name).self_play], cycle(SAMPLING)),
)
def test_every_learner_of_self_play_resumes_in_a_scheme(
    algorithm: str, sampling: str, tmp_path: Path
) -> None:
    """A diagonal as above, with the sizes of the defaults."""
    settings = both(
        sampling=sampling,
        pool_size=7,
        chaser=LearningSide(hyper=PPO) if algorithm == "ppo" else side_by(algorithm),
        frames=40_000,
        members=("astar",),
    )
    check_resumption(SELF_PLAY, settings, tmp_path)


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"evader": "astar"}, marks=pytest.mark.slow),
        pytest.param(
            {"task": {"num_chasers": 2, "num_evaders": 2}, "sampling": "nash-mixture",
             "pool_size": 7},
            marks=pytest.mark.slow,
        ),
        {"hyper": replace(PPO, recurrent="gru"), "sampling": "pfsp"},
        pytest.param(
            {"task": {"num_chasers": 2}, "hyper": replace(PPO, recurrent="gru")},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["a frozen side", "teams", "memories", "memories of a team"],
)  # fmt: skip
def test_teams_and_memories_resume(changes: Any, tmp_path: Path) -> None:
    check_resumption(SELF_PLAY, both(**changes), tmp_path)


class Drawing:
    """A policy that draws from the random numbers of its agent, and tells no distribution."""

    role = "chaser"

    def __init__(self, task: Any = None, role: str = "") -> None:
        pass

    def act(self, view: Any) -> Any:
        return (4 * view.uniform()).astype(np.int32)


@pytest.mark.parametrize("algorithm", [name for name in SINGLE if entry(name).imitates])
def test_a_learner_that_imitates_resumes(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is imitated draws; the weight of imitation becomes 0 at 60 % of the budget."""
    drawn: Any = ModuleType("drawn")
    drawn.Drawing = Drawing
    monkeypatch.setitem(sys.modules, "drawn", drawn)
    frames = LONGER.get(algorithm, FRAMES)
    how = {"imitate": "drawn:Drawing", "imitate_frames": round(0.6 * frames)}
    check_resumption(RUN, tiny(algorithm, **CHASER, **how), tmp_path)


def test_self_play_that_imitates_resumes(tmp_path: Path) -> None:
    check_resumption(SELF_PLAY, both(imitate="astar", imitate_frames=FRAMES), tmp_path)


# -- longer budgets --------------------------------------------------------------------------------

GAME = {"game": "trained_games:Stones(num_players=3)", "player": "b", "observation": "one_hot"}
EXTENDED: dict[str, tuple[str, Callable[[], Any]]] = {
    **{name: (RUN, lambda name=name: of_any(name)) for name in SINGLE},
    "a curriculum": (RUN, lambda: taught("ppo", "opponent-epsilon")),
    "an adaptive curriculum": (RUN, lambda: taught("ppo", "success-gated")),
    "a small game": (RUN, lambda: tiny("ppo", **GAME)),
    "a recurrent network": (RUN, lambda: tiny("ppo", recurrent="gru", **CHASER)),
    "latest": (SELF_PLAY, both),
    "pfsp": (SELF_PLAY, lambda: both(sampling="pfsp", members=("astar",))),
    "nash-mixture": (SELF_PLAY, lambda: both(sampling="nash-mixture", pool_size=7)),
}


def of_any(algorithm: str) -> Any:
    """A short run of a runner, or of an arm."""
    return tiny(algorithm, **(RUNNER if "discrete" in ALGORITHMS[algorithm].actions else ARM))


def trained_state(folder: Path) -> Any:
    """The state of training without what evaluations change, which are at other times."""
    state = load_checkpoint(folder)["trainee"]
    for name in ("finished", "teacher", "progress", "partners"):
        state.pop(name, None)
    return state


@pytest.mark.filterwarnings("ignore:.*annealed to 0")
@pytest.mark.parametrize("name", EXTENDED)
def test_a_run_with_a_longer_budget_ends_where_one_without_an_end_between_does(
    name: str, tmp_path: Path
) -> None:
    """The same iterations with the schedules of the first budget; stopped and killed on the way."""
    kind, make = EXTENDED[name]
    settings = make()
    frames = settings.frames
    whole = start(kind, replace(settings, frames=2 * frames), tmp_path / "whole")
    whole.budget = replace(whole.budget, schedule=float(frames))
    whole.train()
    parts = tmp_path / "parts"
    start(kind, settings, parts).train()
    rows = read_metrics(parts)
    stop_in(resume(parts, kind, frames=2 * frames), "iterate", 0.6)
    with pytest.raises(KilledError):
        carry_on(resume(parts, kind), 0.8, kill)
    resume(parts, kind).train()
    check_same(trained_state(tmp_path / "whole"), trained_state(parts), name)
    longer = read_metrics(parts)
    check_same(longer[: len(rows)], rows, "the evaluations of the first budget")
    assert len(longer) > len(rows) and longer[-1]["frames"] >= 2 * frames
    assert len(read_kept_list(parts).kept) >= 4


@pytest.mark.parametrize("kind", [RUN, SELF_PLAY])
def test_schedules_keep_their_end_or_extend_over_the_new_budget(kind: str, tmp_path: Path) -> None:
    settings = tiny("ppo", **CHASER) if kind == RUN else both()
    shares = []
    for stretch in (False, True):
        folder = tmp_path / str(stretch)
        start(kind, settings, folder).train()
        with contextlib.nullcontext() if stretch else pytest.warns(UserWarning, match="to 0"):
            run = resume(folder, kind, frames=4 * settings.frames, stretch=stretch)
        shares.append(run.scheduled)
        (own,) = load_config(folder).longer
        assert (own.budget, own.at, own.stretch) == (settings.frames, run.trainee.frames, stretch)
        assert own.sha256 == sha256_in(folder)
        if kind == SELF_PLAY:
            before = len(list(folder.glob("pool/chaser/*.pt")))
            run.trainee.pools["chaser"].capacity = 100  # so that all are kept
        run.train()
        if kind == SELF_PLAY:  # of 7 over the first budget
            new = len(list(folder.glob("pool/chaser/*.pt"))) - before
            assert new == pytest.approx(5 if stretch else 21, abs=1)
    assert shares == [pytest.approx(4 * share) for share in shares[1:] for _ in (0,)] + shares[1:]
    assert 1.0 <= shares[0] < 1.1


def test_the_same_longer_budget_again_goes_on_and_less_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    start(RUN, tiny("ppo", **CHASER, anneal=False), folder).train()
    with pytest.raises(KilledError):
        carry_on(resume(folder, RUN, frames=3 * FRAMES), 0.6, kill)
    resume(folder, RUN, frames=3 * FRAMES).train()
    assert len(load_config(folder).longer) == 1
    for bad, message in (
        ({"frames": 2 * FRAMES}, "frames=1,800 is less than its budget of 2,700 frames"),
        ({"seconds": 9.0}, "its budget is in frames; give a longer one by --frames"),
        ({"stretch": True}, "--stretch needs a longer budget"),
    ):
        before = (folder / "config.json").read_bytes()
        with pytest.raises(ValueError, match=message):
            resume(folder, RUN, **bad)
        assert (folder / "config.json").read_bytes() == before
    kept = next(iter(kept_policies(folder).values()))
    with pytest.raises(ValueError, match="a policy that was kept; give its run, or start from it"):
        resume(kept, RUN, frames=9 * FRAMES)


@pytest.mark.parametrize("kind", [RUN, SELF_PLAY])
def test_a_run_with_results_but_without_a_checkpoint_is_not_begun_again(
    kind: str, tmp_path: Path
) -> None:
    settings = tiny("ppo", **CHASER) if kind == RUN else both()
    run = start(kind, settings, tmp_path)
    run.train()
    run.results(episodes=5)
    (tmp_path / "checkpoint.pt").unlink()
    before = (tmp_path / "metrics.csv").read_bytes()
    with pytest.raises(ValueError, match=r"has results, but checkpoint\.pt is missing; restore"):
        resume(tmp_path, kind, frames=4 * settings.frames)
    assert (tmp_path / "metrics.csv").read_bytes() == before


def test_a_budget_in_seconds_is_extended(tmp_path: Path) -> None:
    settings = replace(tiny("ppo", **CHASER, anneal=False), frames=None, seconds=0.05)
    start(RUN, settings, tmp_path / "run").train()
    run = resume(tmp_path / "run", RUN, seconds=0.1)
    frames = run.trainee.frames
    run.train()
    assert run.seconds >= 0.1 and run.trainee.frames > frames
    assert resume(tmp_path / "run", RUN).is_trained


# -- weights of other runs -------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in EXTENDED if name != "nash-mixture"])
def test_a_run_that_starts_from_the_weights_of_another_resumes(name: str, tmp_path: Path) -> None:
    kind, make = EXTENDED[name]
    settings, source = make(), tmp_path / "source"
    start(kind, settings, source).train()
    settings = replace(settings, init_from=str(source), seed=1)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run = start(kind, settings, whole)
    assert load_config(whole).init_sha256 == sha256_in(source)
    there = load_checkpoint(source)["trainee"]
    for own, other in (
        [(run.trainee.learner.state_dict(), there["learner"])]
        if kind == RUN
        else [
            (side.learner.state_dict(), load_checkpoint(source / role)["trainee"]["learner"])
            for role, side in run.trainee.sides.items()
        ]
    ):
        for part in {"network", "q_values"} & {*own}:
            weights = [
                dict(each) if part == "network" else each for each in (own[part], other[part])
            ]
            check_same(*weights, part)
        assert own["frames"] == 0
    run.train()
    start(kind, settings, parts)  # killed before the first iteration
    stop_in(resume(parts, kind), "iterate", 0.4)
    resume(parts, kind).train()
    check_same_runs(whole, parts)


def test_weights_of_another_maze_of_a_side_and_of_a_kept_policy(tmp_path: Path) -> None:
    pair = both(observation="positions", frames=FRAMES)
    start(SELF_PLAY, pair, tmp_path / "pair").train()
    side = tmp_path / "pair" / "chaser"
    game = {**CHASER, "maze": "5x5", "observation": "positions", "shared": True}
    for source in (side, *kept_policies(side).values()):
        if source.is_dir():
            run = start(
                RUN, tiny("ppo", **game, init_from=str(source)), tmp_path / f"of {source.name}"
            )
            weights = load_checkpoint(source)["trainee"]["learner"]["network"]
            check_same(dict(run.trainee.learner.network.state_dict()), dict(weights), "weights")
    alone = tmp_path / "alone"
    start(RUN, tiny("ppo", **{**game, "maze": "3x3", "role": "evader"}), alone).train()
    run = start(SELF_PLAY, replace(pair, init_from=str(alone)), tmp_path / "of one")
    weights = load_checkpoint(alone)["trainee"]["learner"]["network"]
    check_same(run.trainee.sides["evader"].weights, dict(weights), "weights")
    assert not torch.equal(
        run.trainee.sides["chaser"].weights["policy_head.weight"], weights["policy_head.weight"]
    )
    # Without a checkpoint it starts from the source again, which must be the same.
    (alone / "checkpoint.pt").unlink()
    with pytest.raises(ValueError, match="other weights than when it was started"):
        resume(tmp_path / "of one", SELF_PLAY)


def test_weights_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    source = tmp_path / "source"
    start(RUN, tiny("ppo", **CHASER), source).train()
    for name, flat in {
        "width": {"width": 16},
        "maze": {"maze": "5x5"},
        "dqn": {"algorithm": "dqn"},
        "activation": {"activation": "tanh"},
        "table": {"algorithm": "q_learning"},
    }.items():
        given = {"algorithm": "ppo", **CHASER, **flat, "init_from": str(source)}
        with pytest.raises(ValueError, match=r"init_from='.*source': its network does not fit"):
            start(RUN, tiny(given.pop("algorithm"), **given), tmp_path / name)
    for kind, given in ((RUN, {"algorithm": "ppo", **CHASER}), (SELF_PLAY, {"maze": "3x3"})):
        make = settings_of if kind == RUN else self_play_settings_of
        with pytest.raises(ValueError, match="no run here"):
            make(**given, frames=900, init_from=str(tmp_path / "nowhere"))
    with pytest.raises(ValueError, match="init_from=; give a folder, or leave it out"):
        settings_of(frames=900, init_from="")
    # A run that has begun does not need its source.
    gone = start(RUN, tiny("ppo", **CHASER, init_from=str(source)), tmp_path / "gone")
    gone.train()
    source.rename(tmp_path / "elsewhere")
    assert resume(tmp_path / "gone", RUN).is_trained
    (tmp_path / "elsewhere").rename(source)
    with pytest.raises(ValueError, match="has no policy of evader"):
        start(SELF_PLAY, both(chaser="astar", init_from=str(source)), tmp_path / "other")


# -- random states ---------------------------------------------------------------------------------


def test_the_generators_of_gpus_are_in_the_checkpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    states = [torch.full((16,), 1, dtype=torch.uint8), torch.full((16,), 2, dtype=torch.uint8)]
    taken: dict[int, torch.Tensor] = {}
    for name, stand_in in {
        "is_available": lambda: True,
        "is_initialized": lambda: True,
        "device_count": lambda: 2,
        "get_rng_state_all": lambda: states,
        "set_rng_state": lambda state, device: taken.__setitem__(device, state),
    }.items():
        monkeypatch.setattr(torch.cuda, name, stand_in)
    saved = random_states()
    assert saved["cuda_rng"] == states
    set_random_states(saved)
    assert list(taken.items()) == [(0, states[0]), (1, states[1])]
    taken.clear()
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    set_random_states(saved)
    assert list(taken) == [0]
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: False)
    assert random_states()["cuda_rng"] == []  # a run on the CPU does not initialise a GPU


def test_the_comparison_finds_differences() -> None:
    check_same({"a": [1.0, math.nan], "seconds": 1}, {"a": [1.0, math.nan], "seconds": 2}, "")
    for one, two in (({"a": 1}, {"a": 2}), ([1], [1, 2]), (torch.ones(2), torch.zeros(2))):
        with pytest.raises(AssertionError):
            check_same(one, two, "")
