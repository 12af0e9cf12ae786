"""The search for settings: successive halving against halves that are sorted here."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from train.experiments.expansion import load_study
from train.experiments.recorded import record
from train.experiments.runs import prepare
from train.experiments.search import draw_samples
from train.experiments.study import StudyFile, choose_version, read_file, shipped
from train.experiments.tuning import LEAST, TuningSearch, tuning_search_of

FILE = """
title = "Halves"
kind = "self-play"
control = "ppo"
seeds = [0]
variants = [{ name = "ppo" }, { name = "ppo with momentum", adam_beta1 = 0.9 },
            { name = "mmd", algorithm = "mmd" }]
[report]
x = "game"
[settings]
frames = 8000
width = 8
[grid]
game = ["soccer(rows=2,columns=4)"]
[tuning]
games = ["goofspiel(cards=2)", "goofspiel(cards=3)"]
shipped = false
search_seed = 3
short = { samples = 7, frames = 1000, rungs = 3 }
full = { samples = 7, frames = 1000, rungs = 3 }
like = { "ppo with momentum" = "ppo" }
[tuning.space.ppo]
learning_rate = { low = 1e-3, high = 1e-2, scale = "log" }
[tuning.space.mmd]
magnet_coef = { low = 0.01, high = 0.5, scale = "log" }
"""


def halving(folder: Path, text: str = FILE) -> TuningSearch:
    path = folder / "halves.toml"
    path.write_text(text)
    content = read_file(str(path), "ablation", StudyFile)[1]
    assert content.tuning is not None
    file = choose_version(content, None)
    return tuning_search_of(content.tuning, None, folder / "tuning", file, folder / "tuning.csv")


def conv(variant: str, trial: int, game: str, rung: int) -> float:
    """NashConv that a trial is given: the order of trials is another one in every rung."""
    return (trial * (5 if variant == "ppo" else 3) + 2 * rung) % 7 + len(game) / 100 + 0.1


def test_the_better_half_goes_on_with_twice_the_frames(tmp_path: Path) -> None:
    found = halving(tmp_path)
    left = {"ppo": list(range(7)), "mmd": list(range(7))}
    games = found.tuning.games
    failing = ("ppo", left["ppo"][4])
    for rung in found.rungs:
        assert found.chosen() == {}
        study = found.study(rung)
        tried = {(run.label["variant"], run.label["trial"]) for run in study.runs}
        assert tried == {(name, number) for name, own in left.items() for number in own}
        assert {run.settings.frames for run in study.runs} == {1000 * 2**rung}
        assert {run.label["game"] for run in study.runs} == set(games)
        for run in study.runs:
            variant, trial, game = (run.label[n] for n in ("variant", "trial", "game"))
            failed = rung == 0 and (variant, trial) == failing
            row = {"run": run.name, "kind": run.kind, "status": "failed" if failed else "complete"}
            row |= {**run.label, "seed": run.seed, "payoff_range": 2.0}
            row["budget_frames"] = run.settings.frames
            record(
                tmp_path / "tuning.csv",
                row | {"played_nash_conv": conv(variant, trial, game, rung)},
            )
        prepare(study, found.folder(rung))

        def score(name: str, trial: int, rung: int = rung) -> float:
            if rung == 0 and (name, trial) == failing:
                return math.inf
            return sum(math.log(conv(name, trial, game, rung) / 2.0 + LEAST) for game in games)

        ranked = {name: sorted(own, key=lambda t: score(name, t)) for name, own in left.items()}
        left = {name: own[: len(own) // 2] for name, own in ranked.items()}
    best = found.chosen()
    for name, space in found.tuning.space.items():
        drawn = draw_samples({**space, "samples": 7, "seed": 3}, 100)
        assert best["", name] == drawn[ranked[name][0]]
    assert best["", "ppo with momentum"] == best["", "ppo"]

    file = str(tmp_path / "halves.toml")
    runs = {
        run.label["variant"]: run.settings
        for run in load_study(file, "ablation", None, tuned=best).runs
    }
    rates = {name: runs[name].side("A").hyper for name in runs}
    assert rates["ppo"].learning_rate == best["", "ppo"]["learning_rate"]
    assert rates["ppo with momentum"].learning_rate == rates["ppo"].learning_rate
    assert (rates["ppo"].adam_beta1, rates["ppo with momentum"].adam_beta1) == (0.0, 0.9)
    assert rates["mmd"].magnet_coef == best["", "mmd"]["magnet_coef"]


def test_settings_of_all_are_drawn_alike_for_every_variant(tmp_path: Path) -> None:
    text = FILE.replace("[tuning.space.ppo]", "[tuning.space.all]")
    text = text.replace(
        "learning_rate = {", "adam_beta1 = { low = 0.0, high = 0.9 }\nlearning_rate = {"
    )
    found = halving(tmp_path, text)
    names = [each.task for each in found.searched]
    assert names == ["ppo", "mmd"]  # the other one is like ppo
    tried = {(run.label["variant"], run.label["trial"]): run.label for run in found.study(0).runs}
    common = draw_samples({**found.tuning.space["all"], "samples": 7, "seed": 3}, 100)
    coefs = {tried["mmd", trial]["magnet_coef"] for trial in range(7)}
    assert len(coefs) == 7
    for trial, values in enumerate(common):
        for name in names:
            assert values.items() <= tried[name, trial].items()
    # What a variant sets itself is not searched.
    own = halving(tmp_path, text.replace('like = { "ppo with momentum" = "ppo" }', ""))
    assert [each.task for each in own.searched] == ["ppo", "ppo with momentum", "mmd"]
    runs = [run for run in own.study(0).runs if run.label["variant"] == "ppo with momentum"]
    assert len(runs) == 14
    for run in runs:
        hyper = next(iter(run.settings.sides.values())).hyper
        assert hyper.adam_beta1 == 0.9
        assert hyper.learning_rate == common[run.label["trial"]]["learning_rate"]


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in shipped("ablation") if not n.startswith("self-play")])
def test_trials_have_the_task_of_the_study_and_the_curriculum_of_their_variant(name: str) -> None:
    file = choose_version(read_file(name, "ablation", StudyFile)[1], "full")
    if file.tuning is None:
        assert name == "mazes"
        return
    trials = tuning_search_of(file.tuning, "full", Path("nowhere"), file).study(0).runs
    judged = {run.label["variant"]: run for run in load_study(name, "ablation", "full").runs}
    for run in trials:
        other = judged[run.label["variant"]]
        assert run.kind == other.kind and run.settings.curriculum == other.settings.curriculum
        assert replace(run.settings.task, maze="5x5") == replace(other.settings.task, maze="5x5")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[tuning.space.mmd]", "[tuning.space.other]", "'other' in .tuning.; give the name"),
        ('momentum" = "ppo"', 'momentum" = "rnad"', "like 'rnad'"),
        ("goofspiel(cards=3)", "soccer(rows=2,columns=4)", "are those of the study"),
        ("rungs = 3", "rungs = 0", "rungs=0"),
        ("rungs = 3", "rungs = 4", "rungs=4 with samples=7 in .tuning.; give at most 3"),
        ("frames = 1000, rungs = 3", "frames = 300_000_000, rungs = 3", "budget 1.2e.09"),
        ("[tuning.space.ppo]", "[tuning.spare.ppo]", "spare"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in FILE
    with pytest.raises(ValueError, match=message):
        halving(tmp_path, FILE.replace(old, new))


@pytest.mark.parametrize("place", ["settings", "grid", "search"])
@pytest.mark.parametrize(
    ("game", "same"),
    [
        ("soccer", "soccer( rows=4, columns=5 )"),
        ("goofspiel(order=descending, cards=4)", "goofspiel(cards=4,order='descending')"),
        ("maze_game(maze='3x3')", "maze_game( maze = '3x3' )"),
    ],
)
def test_a_game_of_the_study_is_not_searched_wherever_it_stands(
    place: str, game: str, same: str
) -> None:
    tables: dict[str, Any] = {"settings": {"frames": 10}}
    tables["variants"] = [{"name": "a"}, {"name": "b"}]
    tables[place] = {**tables.get(place, {}), "game": game if place == "settings" else [game]}
    tables["report"] = {"x": "game"} if place == "grid" else {}
    trials = {"samples": 2, "frames": 10}
    tuning: dict[str, Any] = {"space": {"all": {}}, "short": trials, "full": trials}
    for games, refused in (([same], True), (["border_control", same], True), (["nim:A"], False)):
        found = msgspec.convert(
            {**tables, "control": "a", "tuning": {**tuning, "games": games}}, StudyFile
        )
        with pytest.raises(ValueError, match="are those of the study" if refused else "nim"):
            tuning_search_of(found.tuning, None, Path("nowhere"), found)
