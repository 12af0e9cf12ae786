"""Studies of small games: files, trust, pairing by game, rows and reports."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_rel

from pursuit.plugins import _allowed, _named, allow
from train.experiments.executors import perform
from train.experiments.expansion import load_study
from train.experiments.library_runs import library_settings_of
from train.experiments.report import report_on
from train.experiments.rows import StudyRows, read_study
from train.experiments.runs import Study, prepare
from train.experiments.statistics import least_sign_flip_p
from train.experiments.study import Layout
from train.experiments.variants import against_control, out_of_reach

Row = dict[str, Any]

GAME = '''
class Pennies:
    """Matching pennies, so many times."""

    players = ("even", "odd")

    def __init__(self, rounds=1):
        self.rounds = rounds

    def starts(self):
        return [(1.0, 0)]

    def legal_actions(self, state, player):
        return ("heads", "tails")

    def transitions(self, state, actions):
        won = 1.0 if actions[0] == actions[1] else -1.0
        return [(1.0, state + 1, (won, -won), state + 1 == self.rounds)]


def heads(state):
    return {"heads": 1.0}
'''

SELF_PLAY = """
kind = "self-play"
seeds = [0]
episodes = 10
control = "latest"
[settings]
frames = 512
num_games = 16
minibatch_size = 64
max_steps = 5
[settings.even]
entropy_coef = 0.05
[grid]
game = ["study_games:Pennies", "study_games:Pennies(rounds=2)"]
[[variants]]
name = "latest"
[[variants]]
name = "uniform"
sampling = "uniform"
snapshots = 2
odd.learning_rate = 0.005
[report]
x = "game"
"""

TRAIN = """
seeds = [0, 1]
episodes = 10
[settings]
frames = 512
num_games = 16
max_steps = 5
player = "odd"
opponent = "study_games:heads"
game = "study_games:Pennies"
[grid]
minibatch_size = [32, 64]
"""


@pytest.fixture
def games(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a module of games, which files may not name yet."""
    (tmp_path / "study_games.py").write_text(GAME)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("study_games", None)
    _allowed.discard("study_games")
    _named.difference_update([name for name in _named if name.startswith("study_games:")])


def study_in(folder: Path, text: str, kind: str = "sweep") -> Study:
    (folder / "study.toml").write_text(text)
    return load_study(str(folder / "study.toml"), kind)


def performed(study: Study, out: Path) -> Path:
    """The folder of a study whose runs are all executed, in this process."""
    for _, folder in prepare(study, out):
        perform(folder)
    return out


# -- files -----------------------------------------------------------------------------------------


def test_a_file_that_names_a_game_needs_trust_and_its_source_counts(games: Path) -> None:
    for text in (TRAIN, SELF_PLAY):
        with pytest.raises(ValueError, match="if you trust it, add --allow study_games"):
            study_in(games, text)
    assert "study_games" not in sys.modules  # nothing was imported
    allow("study_games")
    before = study_in(games, TRAIN)
    [run, *_], folder = before.runs, games / "out"
    prepare(before, folder)
    recorded = json.loads((folder / "runs" / run.name / "config.json").read_text())["parts"]
    assert recorded["game"]["name"] == "study_games:Pennies"
    assert set(recorded) == {"game", "opponent"} and len(recorded["game"]["sha256"]) == 64
    (games / "study_games.py").write_text(GAME + "\n# changed\n")
    after = study_in(games, TRAIN)
    assert not {run.name for run in before.runs} & {run.name for run in after.runs}


def test_players_have_tables_of_settings_and_fixed_policies(games: Path) -> None:
    allow("study_games")
    runs = study_in(games, SELF_PLAY, "ablation").runs
    assert len(runs) == 4
    for run in runs:
        sides = run.settings.sides
        assert sides["even"].hyper.entropy_coef == 0.05 != sides["odd"].hyper.entropy_coef
        assert (sides["odd"].hyper.learning_rate == 0.005) == (run.label["variant"] == "uniform")
    fixed = SELF_PLAY.replace("[settings.even]\nentropy_coef = 0.05", 'even = "study_games:heads"')
    fixed = fixed.replace('sampling = "uniform"\nsnapshots = 2\n', "")
    study = study_in(games, fixed, "ablation")
    [(_, folder), *_] = prepare(study, games / "fixed")
    config = json.loads((folder / "config.json").read_text())
    assert config["players"]["even"] == config["parts"]["even"]["name"] == "study_games:heads"


def test_a_run_of_self_play_is_a_fixed_player_and_is_copied_whole(games: Path) -> None:
    allow("study_games")
    played = performed(study_in(games, SELF_PLAY, "ablation"), games / "out")
    source = min(path for path in (played / "runs").iterdir() if "rounds" not in path.name)
    odd = SELF_PLAY.replace("odd.learning_rate = 0.005", "").replace(
        'sampling = "uniform"\nsnapshots = 2', "even.learning_rate = 0.01"
    )
    odd = odd.replace("max_steps = 5", f'max_steps = 5\nodd = "{source}"')
    odd = odd.replace(', "study_games:Pennies(rounds=2)"', "")
    out = performed(study_in(games, odd, "ablation"), games / "fixed")
    rows = read_study(out).rows
    assert [row["odd"] for row in rows] == [str(source)] * 2  # as in the file, not the copy
    assert all(row["even_gain"] >= 0.0 for row in rows)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('x = "game"', 'x = "max_steps"', "is not in .grid."),
        ('control = "latest"', 'control = "latest"\nprimary = "uniform"', "is for gaps in steps"),
        ('control = "latest"', 'control = "latest"\nmargin = 2.0', "is for gaps in steps"),
        ("snapshots = 2", "max_steps = 4", "variant 'uniform' sets max_steps; all variants have"),
        ("settings.even", "settings.nobody", "unknown setting 'nobody.entropy_coef'"),
        ("Pennies(rounds=2)", "Pennies(round=2)", "does not accept the arguments"),
    ],
)
def test_what_does_not_fit_is_refused(games: Path, old: str, new: str, message: str) -> None:
    allow("study_games")
    with pytest.raises(ValueError, match=message):
        study_in(games, SELF_PLAY.replace(old, new, 1), "ablation")


def test_libraries_are_not_compared_in_games() -> None:
    with pytest.raises(ValueError, match="libraries are compared in mazes"):
        library_settings_of(contestant="ours", game="soccer", frames=1000)


# -- rows and reports ------------------------------------------------------------------------------


def rows_of(kind: str, column: str, values: dict[str, list[list[float]]]) -> StudyRows:
    """Rows of games with these values of a column by variant: [games][seeds]."""
    found = StudyRows(Layout("", x="game", control="a", variants=list(values)), x="game")
    for name, games in values.items():
        for place, seeds in enumerate(games):
            for seed, value in enumerate(seeds):
                row = {"kind": kind, "variant": name, "seed": seed, "run": "", column: value}
                found.rows.append(row | {"game": f"game{place}", "_x": f"game{place}"})
    return found


@pytest.mark.parametrize(
    ("kind", "column", "word"),
    [("self-play", "played_nash_conv", "NashConv"), ("single", "return_regret", "return regret")],
)
def test_variants_are_paired_by_game_after_the_mean_over_seeds(
    kind: str, column: str, word: str
) -> None:
    rng = np.random.default_rng(0)
    control = rng.uniform(0.5, 2.0, size=(8, 3))
    less = control * rng.uniform(0.3, 0.6, size=(8, 1))
    values = {"a": control.tolist(), "b": less.tolist()}
    first, second = against_control(rows_of(kind, column, values))
    differences = np.log(less.mean(axis=1)), np.log(control.mean(axis=1))
    expected = ttest_rel(*differences).confidence_interval(0.95)
    assert np.log([second["ratio_low"], second["ratio_high"]]) == pytest.approx(expected)
    assert first["verdict"] == "control" and second["games"] == 8
    assert second["verdict"].startswith(f"lower {word} (p = ")
    assert second["p"] == pytest.approx(least_sign_flip_p(8))  # all are lower


def test_an_ablation_by_game_says_how_many_games_it_needs(games: Path) -> None:
    allow("study_games")
    lines = out_of_reach(study_in(games, SELF_PLAY, "ablation"))
    enough = next(n for n in range(2, 20) if 2.0 / 2**n < 0.05)
    assert len(lines) == 1 and f"give {enough} games or more" in lines[0]


def test_an_ablation_of_self_play_reports_by_game(games: Path) -> None:
    allow("study_games")
    out = performed(study_in(games, SELF_PLAY, "ablation"), games / "out")
    rows = read_study(out).rows
    for row in rows:
        mixed = row["variant"] == "uniform"
        content = json.loads((out / "runs" / row["run"] / "results.json").read_text())
        known = content["mixture_nash_conv"][0] if mixed else row["nash_conv"]
        assert row["played_nash_conv"] == known and row["game"] == content["game"]
    report = (report_on(out) / "report.md").read_text()
    assert "games below latest" in report and "Games are the random units" in report
    assert "NashConv is exact, in returns," in report and "maze" not in report
    header = (out / "report" / "runs.csv").read_text().splitlines()[0].split(",")
    assert {"game", "nash_conv", "played_nash_conv"} <= set(header) and "maze" not in header


def test_a_sweep_of_one_player_reports_its_return_and_regret(games: Path) -> None:
    allow("study_games")
    out = performed(study_in(games, TRAIN), games / "out")
    study = read_study(out)
    for row in study.rows:
        # Against heads the best response of "odd" is tails: a return of 1.
        assert row["return_regret"] == pytest.approx(1.0 - row["mean_return"])
    report = (report_on(out) / "report.md").read_text()
    assert "return regret [95 %]" in report and "Return regret is exact" in report
    assert (out / "report" / "learning_curves.png").stat().st_size > 10_000
