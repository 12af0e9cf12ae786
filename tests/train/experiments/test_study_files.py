"""Study files of all kinds are read completely and expanded to runs, or refused with one line."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import pytest
from test_comparison import TINY as COMPARISON
from test_sweeps import TINY as SWEEP
from test_sweeps import write

from scripted_agents.games import load_game, mixed_share
from train.commands.main import main
from train.experiments.expansion import fitting_analyses, load_study
from train.experiments.identity import fingerprint
from train.experiments.rows import read_all
from train.experiments.runs import Study, prepare
from train.experiments.stages import stages_of
from train.experiments.study import StudyFile, read_file, shipped
from train.experiments.tuning import least_copy_of

TABLE = """
episodes = 20
#top
[settings]
task = "maze"
maze = "2x2"
algorithm = "q_learning"
frames = 2000
num_games = 32
#settings
[grid]
#grid
#rest
"""
ABLATION = """
title = "Tiny"
control = "none"
episodes = 20
seeds = [0, 1]

[settings]
task = "maze"
maze = "3x3"
frames = 6000
max_steps = 40
num_games = 32
minibatch_size = 128

[[variants]]
name = "none"

[[variants]]
name = "near first"
curriculum = "goal-spread-start"

[[variants]]
name = "fewer goals first"
curriculum = "num-goals"
#rest
"""
SELF_PLAY = """
title = "Tiny"
kind = "self-play"
control = "latest"
seeds = [0]

[grid]
maze = ["2x2", "3x3-tree"]

[report]
x = "maze"

[settings]
frames = 16_000
num_games = 64
minibatch_size = 256

[[variants]]
name = "latest"

[[variants]]
name = "uniform"
sampling = "uniform"
"""
FILES = {"sweep": SWEEP, "table": TABLE, "ablation": ABLATION, "self-play": SELF_PLAY}
FILES |= {"comparison": COMPARISON}
KINDS = {"table": "sweep", "self-play": "ablation"}


def load(path: Path, kind: str, text: str) -> Study:
    """The study of a file of this kind, with its search made as well."""
    path.write_text(text, encoding="utf-8")
    kind = KINDS.get(kind, kind)
    return stages_of(str(path), kind, None, path.parent / "out")[-1].expand()


def change(kind: str, old: str, new: str) -> str:
    """A file with one change, with \\n for a new line; a bare word is the comment it replaces."""
    old, new = old.replace("\\n", "\n"), new.replace("\\n", "\n")
    place = f"#{old}" if f"#{old}\n" in FILES[kind] else old
    assert place in FILES[kind], place
    return FILES[kind].replace(place, new)


TABLE_OF_REFUSALS = Path(__file__).with_name("refusals.tsv").read_text(encoding="utf-8")
REFUSED = [line.split("\t") for line in TABLE_OF_REFUSALS.splitlines()[1:]]
"""The kind of file, the text that is replaced in it, the new text, and the message (a pattern)."""


@pytest.mark.parametrize(("kind", "old", "new", "message"), REFUSED)
def test_what_cannot_run_is_refused_with_one_line_before_anything_runs(
    kind: str, old: str, new: str, message: str, tmp_path: Path
) -> None:
    if kind == "comparison":
        pytest.importorskip("stable_baselines3")
    path = tmp_path / "file.toml"
    with pytest.raises(ValueError, match=message) as caught:
        load(path, kind, change(kind, old, new))
    said = str(caught.value)
    assert said.startswith(str(path)) and "\n" not in said and " | " not in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("kind", "version", "message"),
    [
        ("sweep", None, "no such sweep file"),
        ("ablation", None, "no such ablation file"),
        ("comparison", None, "no such comparison file; shipped are ppo"),
        ("comparison", "medium", "short or full"),
    ],
)
def test_no_such_file_or_version(kind: str, version: str | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_study("ppo" if version else "nothing", kind, version)


@pytest.mark.parametrize(("kind", "name"), [("ablation", "maze-size"), ("sweep", "encodings")])
def test_a_folder_of_its_name_does_not_hide_a_shipped_file(
    kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_study(name, kind, "short").runs


# -- expansion -------------------------------------------------------------------------------------


def test_a_file_is_multiplied_out(tmp_path: Path) -> None:
    sweep = load_study(write(tmp_path / "tiny.toml"))
    assert len(sweep.runs) == 2 * 2 * 2 == len({run.name for run in sweep.runs})
    seen = {
        (r.settings.task.maze, r.settings.algorithm, r.settings.seed, r.settings.threads)
        for r in sweep.runs
    }
    assert seen == {
        (maze, algorithm, seed, 1)
        for maze in ("2x2", "3x3")
        for algorithm in ("a2c", "q_learning")
        for seed in (0, 1)
    }
    assert (sweep.layout.x, sweep.layout.group) == ("maze", ["algorithm"])


def test_seeds_can_belong_to_the_mazes(tmp_path: Path) -> None:
    text = SWEEP.replace("seeds = [0, 1]", "seeds = [0, 1, 0]\npaired = true")
    text = text.replace('["2x2", "3x3"]', '["3x3", "2x2", "2x2"]')
    runs = load_study(write(tmp_path / "tiny.toml", text)).runs
    seen = [(run.seed, run.settings.task.maze, run.settings.algorithm) for run in runs]
    both = ("a2c", "q_learning")
    wanted = [(0, "3x3"), (0, "2x2"), (1, "2x2")]
    assert seen == [(*each, name) for each in wanted for name in both]


def test_combinations_given_twice_are_run_once(tmp_path: Path) -> None:
    doubled = SWEEP.replace('["2x2", "3x3"]', '["2x2", "2x2"]').replace("[0, 1]", "[0, 0]")
    assert len(load_study(write(tmp_path / "tiny.toml", doubled)).runs) == 2


def test_two_names_of_equal_settings_are_refused_and_none_vanishes(tmp_path: Path) -> None:
    variants = (
        '[[variants]]\nname = "ours"\n[[variants]]\nname = "shorter"\nrollout_steps = 4\n[report]'
    )
    text = SWEEP.replace("[report]", variants).replace('["a2c", "q_learning"]', '["a2c"]')
    with pytest.raises(ValueError, match=r"variant='ours'.*and.*variant='shorter' have equal sett"):
        load_study(write(tmp_path / "tiny.toml", text))
    told_apart = text.replace("rollout_steps = 4", "rollout_steps = 8")
    assert len(load_study(write(tmp_path / "tiny.toml", told_apart)).runs) == 2 * 2 * 2


def test_the_fingerprint_depends_on_every_setting_and_the_maze_text(tmp_path: Path) -> None:
    base = load_study(write(tmp_path / "tiny.toml")).runs[0]
    maze = tmp_path / "own.txt"
    prints = {fingerprint(base.kind, base.settings, 20, {})}
    changes = ("stay_action = true", "gamma = 0.5", f'maze = "{maze}"', f'maze = "{maze}" # again')
    for number, line in enumerate(changes):
        middle = "+ + +" if number == 3 else "+-+ +"  # the same file name, another maze in it
        maze.write_text(f"+-+-+\n|   |\n{middle}\n|   |\n+-+-+\n")
        text = SWEEP.replace("num_games = 32", f"num_games = 32\n{line}")
        if "maze" in line:
            text = text.replace('maze = ["2x2", "3x3"]\n', "")
        run = load_study(write(tmp_path / "other.toml", text)).runs[0]
        prints.add(fingerprint(run.kind, run.settings, 20, {}))
    prints.add(fingerprint(base.kind, base.settings, 21, {}))
    assert len(prints) == 6


def test_versions_lie_over_the_common_part(tmp_path: Path) -> None:
    text = SWEEP.replace("seeds = [0, 1]\n", "") + (
        "[short]\nseeds = [7]\n[full]\nseeds = [1, 2, 3]\nsettings = {frames = 9000}\n"
    )
    path = write(tmp_path / "tiny.toml", text)
    short, full = load_study(path), load_study(path, version="full")
    assert {run.settings.seed for run in short.runs} == {7}
    assert {run.settings.seed for run in full.runs} == {1, 2, 3}
    assert {run.settings.frames for run in full.runs} == {9000}


def test_a_random_search_is_drawn_once_and_in_its_ranges(tmp_path: Path) -> None:
    text = SWEEP + (
        "[search]\nsamples = 30\nseed = 3\n"
        'learning_rate = {low = 1e-4, high = 1e-2, scale = "log"}\n'
        "rollout_steps = {choices = [2, 4]}\nwidth = {low = 8, high = 64, whole = true}\n"
    )
    text = text.replace('["a2c", "q_learning"]', '["a2c"]').replace("seeds = [0, 1]\n", "")
    path = write(tmp_path / "tiny.toml", text)
    first, second = load_study(path), load_study(path)
    assert [run.name for run in first.runs] == [run.name for run in second.runs]
    rates = [run.settings.hyper.learning_rate for run in first.runs]
    assert len(set(rates)) == 30 and 1e-4 <= min(rates) < 1e-3 < max(rates) <= 1e-2
    assert {run.settings.hyper.rollout_steps for run in first.runs} == {2, 4}
    assert all(8 <= run.settings.hyper.width <= 64 for run in first.runs)


SIDES = """
kind = "self-play"
settings = {maze = "2x2", frames = 512, num_games = 16, minibatch_size = 64, chaser = {width = 8}}
grid = {chaser.entropy_coef = [0.02, 0.05]}
search = {samples = 1, evader = {clip = {low = 0.1, high = 0.2}}}
[[variants]]
name = "dqn"
evader = {algorithm = "dqn"}
[[variants]]
name = "ppo"
chaser.activation = "tanh"
[short.settings.chaser]
anneal = false
"""


def test_settings_of_one_side_are_tables_in_every_part_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "sides.toml"
    path.write_text(SIDES.replace('evader = {algorithm = "dqn"}', "evader.width = 16"))
    study = load_study(str(path))
    assert [run.label["chaser.entropy_coef"] for run in study.runs] == [0.02, 0.02, 0.05, 0.05]
    for run in study.runs:
        chaser, evader = (run.settings.side(role).hyper for role in ("chaser", "evader"))
        assert (chaser.width, chaser.anneal, evader.anneal) == (8, False, True)
        assert chaser.entropy_coef == run.label["chaser.entropy_coef"]
        assert evader.clip == run.label["evader.clip"] != chaser.clip == 0.2
        found = {"dqn": ("relu", 16), "ppo": ("tanh", 128)}[run.label["variant"]]
        assert (chaser.activation, evader.width) == found
    path.write_text(SIDES)
    with pytest.raises(ValueError, match=r"evader: unknown setting 'clip' of the evader's alg"):
        load_study(str(path))


def test_budgets_on_the_axis_are_settings_not_measurements(tmp_path: Path) -> None:
    text = change("table", "grid", "frames = [1000, 2000]").replace("frames = 2000\n", "")
    sweep = load(tmp_path / "s.toml", "table", text.replace("#rest", "[report]\nx = 'frames'"))
    assert (sweep.layout.x, sweep.layout.group) == ("budget_frames", [])
    prepare(sweep, tmp_path / "out")
    runs = read_all(tmp_path / "out").everything
    assert sorted(row["budget_frames"] for row in runs) == [1000, 2000]


# -- shipped files ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_shipped_file_is_sound_in_its_full_version() -> None:
    for name in shipped():
        assert len(load_study(name, version="short").runs) <= len(
            load_study(name, version="full").runs
        )


def test_every_shipped_file_is_valid(capsys: pytest.CaptureFixture[str]) -> None:
    assert {"tabular", "encodings", "rewards", "maze_by_size", "maze_by_goals"} <= set(shipped())
    assert {"chaser_by_size", "evader_by_size", "dqn_one_goal", "presets"} <= set(shipped())
    main(["sweep", "--list"])  # reads the short versions
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [name for name, *_ in lines] == [*shipped()]
    assert all(title for _, *title in lines)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.slow] * (n != "opponent-epsilon"))
        for n in shipped("ablation")
        if not n.startswith("self-play")
    ],
)
def test_both_versions_of_every_shipped_ablation_are_valid(name: str) -> None:
    for version in ("short", "full"):
        plan = load_study(name, "ablation", version)
        variants, mazes = plan.layout.variants, {run.settings.task.maze for run in plan.runs}
        units = {(run.settings.task.maze, run.settings.seed) for run in plan.runs}
        assert len(plan.runs) == len(variants) * len(units) and len(units) >= 3
        control = [r for r in plan.runs if r.label["variant"] == plan.layout.control]
        assert all(run.settings.curriculum == "none" for run in control)
        # Equal budgets, and the same task to be evaluated on.
        assert len({(run.settings.seconds, run.settings.frames) for run in plan.runs}) == 1
        assert len({replace(run.settings.task, maze="5x5") for run in plan.runs}) == 1
        # No judged maze, also rotated or mirrored, chooses settings.
        tuning = read_file(name, "ablation", StudyFile)[1].tuning
        copies = {least_copy_of(maze) for maze in mazes} if len(mazes) > 1 else set()
        assert not copies & {least_copy_of(maze) for maze in (tuning.mazes if tuning else ())}


STRATA = ((7, 0.0, 1e-9), (7, 1e-9, 0.01), (7, 0.01, 0.05), (8, 0.05, 1.0))
"""Of the judged games of the study by mixed share, in their order: how many have a share above the
first number and up to the second."""


@pytest.mark.slow
def test_the_games_of_the_study_by_mixed_share_lie_in_their_strata() -> None:
    _, file = read_file("self-play-mixing", "ablation", StudyFile)
    _, populations = read_file("self-play-mixing-populations", "ablation", StudyFile)
    assert file.full and file.full.grid and file.tuning and populations.full and populations.tuning
    games = file.full.grid["game"]
    assert len({*games}) == len(games) and not {*games} & {*file.tuning.games}
    ends = list(accumulate(count for count, *_ in STRATA))
    for first, last, (_, low, high) in zip([0, *ends], ends, STRATA, strict=False):
        for name in games[first:last]:
            share = mixed_share(load_game(name), 0.95)
            assert low < share <= high or (high < 1e-6 and share < high), (name, share)
    matrices = [load_game(name) for name in games[ends[-1] :]]
    assert {game.num_states for game in matrices} == {1}
    assert populations.full.grid and {*populations.full.grid["game"]} < {*games[: ends[-1]]}
    assert len(populations.full.grid["game"]) == 14
    assert populations.tuning.games == file.tuning.games
    strata = [range(a, b) for a, b in zip([0, *ends], ends, strict=False)]
    kept = [sum(games.index(n) in own for n in populations.full.grid["game"]) for own in strata]
    assert kept == [3, 3, 4, 4]


@pytest.mark.parametrize(
    ("control", "kind", "games", "x", "fitting"),
    [
        (None, "single", False, "maze", ["summary"]),
        (None, "contestant", False, "variant", ["libraries", "summary"]),
        (None, "contestant", False, "maze", ["summary"]),
        ("a", "single", False, "maze", ["variants", "paired"]),
        ("a", "single", False, "num_goals", ["variants"]),  # no random units to pair by
        ("a", "single", True, "game", ["paired"]),
        ("a", "self-play", False, "maze", ["paired"]),
    ],
)
def test_analyses_that_fit_are_known_before_the_runs(
    control: str | None, kind: str, games: bool, x: str, fitting: list[str]
) -> None:
    assert fitting_analyses(control, kind, games, x) == fitting


def test_an_analysis_that_does_not_fit_is_refused_before_the_runs(tmp_path: Path) -> None:
    goals = 'analysis = "paired"\n' + ABLATION
    with pytest.raises(ValueError, match="analysis='summary' with control='none'"):
        load(tmp_path / "a.toml", "ablation", 'analysis = "summary"\n' + ABLATION)
    assert load(tmp_path / "b.toml", "ablation", goals).layout.analysis == "paired"
