"""Curricula as numbers: schedules at their ends and between, adaptive ones by what they promise."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from curricula import (
    LearningProgress,
    LevelReplay,
    Outcomes,
    Progress,
    Schedule,
    Scheduled,
    Shuffled,
    SuccessGated,
    Uniform,
    constant,
    cosine,
    exponential,
    linear,
    piecewise,
    step,
)
from curricula.levels import MAX_SEED

STAGES = [1.0, 2.0, 4.0, 8.0]
finite = st.floats(-1e6, 1e6)


def outcomes(played: Any, successes: Any = True, **more: Any) -> Outcomes:
    """Outcomes of episodes with these stages; the other values are arbitrary."""
    count = len(played)

    def column(name: str, default: float) -> Any:
        return np.broadcast_to(np.asarray(more.get(name, default), dtype=np.float64), count)

    return Outcomes(
        np.asarray(played, dtype=np.float64),
        np.broadcast_to(np.asarray(successes, dtype=bool), count),
        column("returns", 0.0),
        np.full(count, 10),
        column("regrets", np.nan),
        column("errors", np.nan),
    )


# -- schedules -------------------------------------------------------------------------------------


@example(1.9e-10, 131073.0, 1.0, 0.5)
@example(0.1, 0.1, 1.0, 0.7)
@given(finite, finite, st.floats(0.001, 1e6), st.floats(0, 1))
def test_schedules_meet_their_ends_exactly_and_stay_between(
    start: float, end: float, length: float, share: float
) -> None:
    size = abs(end - start) / 7 or 1.0
    shapes: dict[str, Callable[[float], float]] = {
        "linear": lambda now: linear(start, end, now, length),
        "cosine": lambda now: cosine(start, end, now, length),
        "step": lambda now: step(start, end, now, every=length / 8, size=size),
        "piecewise": lambda now: piecewise([(0.0, start), (length, end)], now),
    }
    for name, shape in shapes.items():
        assert shape(0.0) == start, name
        assert shape(length) == shape(10 * length) == end, name
        assert min(start, end) <= shape(share * length) <= max(start, end), name
    assert linear(start, end, length / 2, length) == pytest.approx((start + end) / 2, abs=1e-6)
    assert cosine(start, end, length / 2, length) == pytest.approx((start + end) / 2, abs=1e-6)


@given(st.floats(0, 1e6), st.floats(0, 1), st.floats(0.001, 0.999), st.integers(0, 10_000))
def test_exponential_begins_at_its_start_and_never_passes_its_floor(
    start: float, share: float, factor: float, progress: int
) -> None:
    floor = share * start
    assert exponential(start, floor, 0.0, 7.0, factor) == start
    assert floor <= exponential(start, floor, progress, 7.0, factor) <= start
    assert exponential(start, floor, 1e9, 7.0, factor) == floor


@pytest.mark.parametrize("shape", ["linear", "cosine", "step"])
def test_rounding_does_not_move_the_start_of_a_schedule(shape: str) -> None:
    assert Schedule(shape, 1.9e-10, 131073.0)(Progress()) == 1.9e-10


@pytest.mark.parametrize(("start", "end"), [(1.0, 0.2), (0.0, 5.0), (2e-3, 0.0), (-1.0, 3.0)])
def test_ordinary_values_are_those_of_the_plain_formulas(start: float, end: float) -> None:
    for share in np.linspace(0.01, 0.99, 99).tolist():
        assert linear(start, end, share) == (1.0 - share) * start + share * end
        turned = end + (start - end) * 0.5 * (1.0 + math.cos(math.pi * share))
        assert cosine(start, end, share) == turned


def test_schedules_are_what_their_formulas_say() -> None:
    assert constant(3.0, 0.7) == 3.0
    assert linear(0.0, 10.0, 0.3) == pytest.approx(3.0)
    assert cosine(1.0, 0.0, 0.25) == pytest.approx(0.5 * (1 + 2**-0.5))
    assert linear(1.0, 0.0, 0.0, 0.0) == 0.0  # a length of 0 is over at once
    assert [step(0, 3, p, every=2) for p in (0, 1.9, 2, 4, 6, 100)] == [0, 0, 1, 2, 3, 3]
    assert [step(3, 0, p, every=2) for p in (0, 1.9, 2, 4, 6, 100)] == [3, 3, 2, 1, 0, 0]
    points = ((0.0, 1.0), (0.5, 0.2), (1.0, 0.4))
    assert [piecewise(points, p) for p in (-1, 0, 0.25, 0.5, 0.75, 1, 2)] == pytest.approx(
        [1, 1, 0.6, 0.2, 0.3, 0.4, 0.4]
    )


def test_exponential_is_the_thesis_loop() -> None:
    epsilon, every = 1.0, 7
    for episode in range(2000):
        assert exponential(1.0, 0.2, episode, every, 0.99) == pytest.approx(epsilon)
        if (episode + 1) % every == 0:
            epsilon = max(0.99 * epsilon, 0.2)
    assert epsilon == 0.2


@pytest.mark.parametrize("unit", ["share", "frames", "episodes", "seconds"])
def test_a_schedule_follows_its_unit(unit: str) -> None:
    schedule = Schedule("linear", 1.0, 0.0, unit, length=0.5)
    assert schedule(Progress(**{unit: 0.25})) == 0.5
    assert schedule(Progress()) == 1.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"length": -1.0}, "length=-1.0"),
        ({"shape": "step", "every": 0.0}, "every=0.0"),
        ({"shape": "exponential", "start": 0.1, "end": 0.2}, "end 0.2 is above the start 0.1"),
        ({"shape": "exponential", "start": 1.0, "end": 0.2, "factor": 1.5}, "factor=1.5"),
        (
            {"shape": "exponential", "start": -1.0, "end": -2.0},
            "start=-1.0; give a start of at least 0",
        ),
        ({"shape": "piecewise"}, "points"),
        ({"shape": "piecewise", "points": ((0.5, 1.0), (0.5, 0.0))}, "increasing"),
        ({"shape": "sine"}, "unknown schedule 'sine'"),
        ({"unit": "minutes"}, "unknown unit 'minutes'"),
        ({"start": float("inf")}, "finite"),
    ],
)
def test_bad_schedules_are_refused_at_birth(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Schedule(**settings)


# -- stages ----------------------------------------------------------------------------------------


def test_a_scheduled_curriculum_gives_all_games_the_value_and_logs_why() -> None:
    curriculum = Scheduled(Schedule("linear", 1.0, 5.0), whole=True)
    seen, changes = [], []
    for share in np.linspace(0, 1, 101):
        changes += curriculum.update(outcomes([]), Progress(share=float(share)))
        games = curriculum.sample(7, np.random.default_rng(0))
        assert len(set(games)) == 1
        seen.append(games[0])
    assert (seen[0], seen[-1]) == (1.0, 5.0) and set(seen) == {1, 2, 3, 4, 5}
    assert [change.mean for change in changes] == [1, 2, 3, 4, 5]
    assert "linear schedule at" in changes[1].reason


def test_success_moves_the_gate_up_and_failure_down() -> None:
    gate = SuccessGated(STAGES, promote_at=0.8, demote_at=0.3, window=10)
    assert [c.reason for c in gate.update(outcomes([]), Progress())] == ["first stage"]
    assert not gate.update(outcomes([1.0] * 9), Progress())  # the window is not full
    assert gate.update(outcomes([1.0]), Progress())[0].mean == 2.0
    # Games that were still in the stage before do not count.
    assert not gate.update(outcomes([1.0] * 50), Progress())
    assert not gate.update(outcomes([2.0] * 10, [True] * 5 + [False] * 5), Progress())
    change = gate.update(outcomes([2.0] * 10, False), Progress())[0]
    assert change.mean == 1.0 and "0.0 % success fell to 30 %" in change.reason
    for _ in range(10):
        gate.update(outcomes([gate.stages[gate.stage]] * 10), Progress())
    assert (gate.sample(3, np.random.default_rng(0)) == 8.0).all()


def test_the_gate_does_not_mistake_quick_successes_for_mastery() -> None:
    """Games of 200 steps at most in which half of the starts are solved in 10 steps, half never."""
    gate = SuccessGated([1.0, 2.0], promote_at=0.6, demote_at=0.0, window=100)
    rng = np.random.default_rng(0)
    played, ends = gate.sample(1000, rng), np.where(rng.random(1000) < 0.5, 10, 200)
    wins = ends == 10
    for now in range(1, 2600):
        gate.promote_at = 0.6 if now < 2000 else 0.4
        over = ends == now
        gate.update(outcomes(played[over], wins[over]), Progress())
        played[over] = gate.sample(int(over.sum()), rng)
        quick = rng.random(int(over.sum())) < 0.5
        wins[over], ends[over] = quick, now + np.where(quick, 10, 200)
        assert gate.stage == 0 or now >= 2000
    assert gate.stage == 1


def test_a_gate_with_other_stages_is_refused() -> None:
    with pytest.raises(ValueError, match="resume with the settings"):
        SuccessGated([1.0, 2.0]).load_state_dict(SuccessGated([1.0, 3.0]).state_dict())


def test_learning_progress_goes_where_the_return_changes() -> None:
    bandit = LearningProgress(STAGES, fast=0.3, slow=0.05, explore_share=0.1)
    rng, drift = np.random.default_rng(0), 0.0
    for _ in range(60):
        drift += 0.1
        played = bandit.sample(200, rng)
        returns = np.where(played == 4.0, drift, 5.0) + 0.01 * rng.standard_normal(200)
        bandit.update(outcomes(played, returns=returns), Progress())
    drawn = bandit.sample(20_000, rng)
    share = np.array([(drawn == stage).mean() for stage in STAGES])
    assert share[2] > 0.8
    assert share[[0, 1, 3]] == pytest.approx(0.1 / 4, abs=0.03)


def test_controls_are_what_they_are_called() -> None:
    rng = np.random.default_rng(0)
    drawn = Uniform(STAGES).sample(40_000, rng)
    for stage in STAGES:
        assert (drawn == stage).mean() == pytest.approx(0.25, abs=0.02)
    shuffled, order = Shuffled(STAGES, length=0.5, seed=3), []
    for share in np.linspace(0, 1, 201):
        shuffled.update(outcomes([]), Progress(share=float(share)))
        order.append(float(shuffled.sample(1, rng)[0]))
    turns = [value for i, value in enumerate(order) if i == 0 or value != order[i - 1]]
    assert sorted(turns[:4]) == STAGES or sorted([*turns[:4], 8.0])[:4] == STAGES
    assert set(order[102:]) == {8.0}
    time = [order[:100].count(stage) for stage in STAGES]
    assert time == pytest.approx([25] * 4, abs=1)


@pytest.mark.parametrize("make", [SuccessGated, LearningProgress, Uniform])
def test_outcomes_of_another_task_are_refused(make: Any) -> None:
    with pytest.raises(ValueError, match=r"outcomes of unknown stage 3; the stages"):
        make(STAGES).update(outcomes([1.0, 3.0]), Progress())


def test_settings_out_of_range_are_refused() -> None:
    for make, message in (
        (lambda: SuccessGated(STAGES, promote_at=1.2), "promote_at=1.2"),
        (lambda: SuccessGated(STAGES, promote_at=0.5, demote_at=0.6), "demote_at below"),
        (lambda: SuccessGated(STAGES, window=0), "window=0"),
        (
            lambda: SuccessGated(STAGES, window=1.5),
            "window=1.5; give a whole number, at least 1 ep",
        ),
        (lambda: SuccessGated(STAGES, window=True), "window=True; give a whole number"),
        (lambda: LevelReplay(capacity=2.5), "capacity=2.5; give a whole number, at least 2 levels"),
        *(
            (lambda kind=kind, value=value: kind([1.0, value]), "all different and finite")
            for kind in (Uniform, SuccessGated, LearningProgress, lambda s: Shuffled(s, 0.5))
            for value in (math.nan, math.inf)
        ),
        (lambda: piecewise([(0.0, math.nan)], 0.0), "give finite numbers"),
        (lambda: piecewise([(0.0, 1.0), (math.inf, 0.0)], 0.0), "give finite numbers"),
        (lambda: Schedule("piecewise", points=((math.nan, 1.0),)), "give finite numbers"),
        (lambda: LearningProgress(STAGES, fast=0.1, slow=0.2), "slow < fast"),
        (lambda: LearningProgress(STAGES, explore_share=-0.1), "explore_share=-0.1"),
        (lambda: Uniform([]), "at least one value"),
        (lambda: Uniform([1.0, 1.0]), "all different"),
        (lambda: LevelReplay("novelty"), "unknown level score 'novelty'"),
        (lambda: LevelReplay(capacity=1), "capacity=1"),
        (lambda: LevelReplay(replay_share=2.0), "replay_share=2.0"),
        (lambda: LevelReplay(temperature=0.0), "temperature=0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            make()  # type: ignore[no-untyped-call]


# -- levels ----------------------------------------------------------------------------------------


def test_levels_with_regret_are_kept_and_played_again() -> None:
    replay = LevelReplay("regret", capacity=50, replay_share=0.5, temperature=0.3, staleness=0.0)
    rng = np.random.default_rng(0)

    def regret(seeds: Any) -> Any:
        return np.where(seeds % 10 == 0, 3.0, 0.1)  # every tenth level is hard

    for _ in range(60):
        seeds = replay.sample(64, rng)
        replay.update(outcomes(seeds, regrets=regret(seeds)), Progress())
    assert len(replay.seeds) == 50 == len(set(replay.seeds))
    assert (replay.seeds % 10 == 0).mean() > 0.9
    drawn = replay.sample(10_000, rng)
    assert np.isin(drawn, replay.seeds).mean() == pytest.approx(0.5, abs=0.02)
    assert (drawn >= 0).all() and (drawn < MAX_SEED).all()


def test_ranks_and_staleness_give_the_published_probabilities() -> None:
    replay = LevelReplay("regret", capacity=4, temperature=0.5, staleness=0.25)
    for seed, value in ((1, 0.1), (2, 0.4), (3, 0.2)):
        replay.update(outcomes([seed], regrets=value), Progress())
    # Ranks 3, 1, 2, so weights 1/9, 1, 1/4; ages 2, 1, 0 updates.
    by_score = np.array([1 / 9, 1.0, 1 / 4])
    expected = 0.75 * by_score / by_score.sum() + 0.25 * np.array([2, 1, 0]) / 3
    assert replay.probabilities() == pytest.approx(expected)


def test_a_level_is_scored_by_its_last_episode_and_learnability_by_all() -> None:
    replay = LevelReplay("value_loss", capacity=4)
    replay.update(outcomes([7, 8, 7], errors=[0.9, 0.5, 0.2]), Progress())
    assert dict(zip(replay.seeds, replay.scores, strict=True)) == {7: 0.2, 8: 0.5}
    learn = LevelReplay("learnability", capacity=4)
    learn.update(outcomes([7, 8, 7], [True, False, False]), Progress())
    learn.update(outcomes([7], [True]), Progress())
    found = dict(zip(learn.seeds, learn.scores, strict=True))
    assert found[7] == pytest.approx(3 / 5 * 2 / 5) and found[8] == pytest.approx(1 / 3 * 2 / 3)
    assert learn.scores.argmax() == list(learn.seeds).index(7)
    assert learn.counts[:, learn.scores.argmax()].tolist() == [2, 3]


def test_unknown_optima_and_impossible_seeds_are_refused() -> None:
    with pytest.raises(ValueError, match="needs the exact optimum"):
        LevelReplay("regret").update(outcomes([1]), Progress())
    for seed in (0.5, -1.0):
        with pytest.raises(ValueError, match=f"outcomes of level {seed:g}; seeds are whole numb"):
            LevelReplay("learnability").update(outcomes([3.0, seed]), Progress())


# -- all of them -----------------------------------------------------------------------------------

EVERY = {
    "scheduled": lambda: Scheduled(Schedule("linear", 1.0, 8.0), whole=False),
    "uniform": lambda: Uniform(STAGES),
    "shuffled": lambda: Shuffled(STAGES, 0.5),
    "gated": lambda: SuccessGated(STAGES, window=20),
    "progress": lambda: LearningProgress(STAGES),
    "replay": lambda: LevelReplay("learnability", capacity=30),
}


@pytest.mark.parametrize("name", EVERY)
def test_a_curriculum_goes_on_exactly_from_its_state(name: str) -> None:
    def play(curriculum: Any, rng: Any, begin: int, end: int) -> list[Any]:
        sampled = []
        for turn in range(begin, end):
            played = curriculum.sample(16, rng)
            returns = rng.standard_normal(16) + played / 8 % 3
            ended = outcomes(played, rng.random(16) < 0.7, returns=returns)
            changes = curriculum.update(ended, Progress(share=turn / 40))
            sampled.append((played.tolist(), changes))
        return sampled

    curriculum, rng = EVERY[name](), np.random.default_rng(1)
    play(curriculum, rng, 0, 20)
    state, other = copy.deepcopy(curriculum.state_dict()), copy.deepcopy(rng)
    resumed = EVERY[name]()
    resumed.load_state_dict(state)
    assert play(resumed, other, 20, 40) == play(curriculum, rng, 20, 40)
    with pytest.raises(ValueError, match="of another curriculum"):
        resumed.load_state_dict({"something": 1})


@pytest.mark.parametrize("seed", range(5))
def test_stages_are_drawn_as_numpys_own_functions_draw_them(seed: int) -> None:
    ours, theirs = (np.random.default_rng(seed) for _ in range(2))
    stages = [3.0, 1.0, 7.0, 2.0]
    uniform, progress, levels = Uniform(stages), LearningProgress(stages), LevelReplay()
    for chances in ([0.25] * 4, [0.1, 0.0, 0.6, 0.3]):
        progress.probabilities = np.array(chances)
        for count in (1, 5, 200):
            chosen = theirs.choice(stages, count, p=chances)
            assert (progress.sample(count, ours) == chosen).all()
            assert (uniform.sample(count, ours) == theirs.choice(stages, count)).all()
            assert (levels.sample(count, ours) == theirs.integers(0, MAX_SEED, count)).all()
