"""Sweep files and the files of a sweep are read completely, or refused with one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from train.commands.main import main
from train.experiments.ablation import load_ablation
from train.experiments.forms import HINTS, LABEL, read_hints, read_label
from train.experiments.study import ERROR, PROGRESS, prepare
from train.experiments.sweep import load_sweep
from train.experiments.tables import collect, error_of
from train.experiments.worker import progress_of

SWEEP = """
episodes = 20
{top}
[settings]
task = "maze"
maze = "2x2"
algorithm = "q_learning"
frames = 2000
num_games = 32
{settings}
[grid]
{grid}
{rest}
"""
ABLATION = """
control = "a"
[settings]
task = "maze"
maze = "2x2"
frames = 2000
[[variants]]
name = "a"
[[variants]]
name = "b"
gamma = 0.5
{rest}
"""


def load(tmp_path: Path, **parts: str) -> Any:
    empty = dict.fromkeys(("top", "settings", "grid", "rest"), "")
    (tmp_path / "s.toml").write_text(SWEEP.format(**(empty | parts)))
    return load_sweep(str(tmp_path / "s.toml"))


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
    study = load_sweep(str(path))
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
        load_sweep(str(path))


@pytest.mark.parametrize(
    ("part", "text", "message"),
    [
        ("grid", "seed = [0, 1]", r"seed in \[grid\] .* give seeds = \[...\] at the top"),
        ("settings", "seed = 5", r"seed in \[settings\] .* give seeds = \[...\]"),
        ("rest", "[[variants]]\nname = 'a'\nseed = 5", "seed in 'a' is not allowed"),
        ("rest", "[[variants]]\nname = ['a']", "give each a different name"),
        ("top", "variants = [1, 2]", r"variants\[0\]: a table expected, a whole number found"),
        ("top", "title = 3", "field title: a string or nothing expected, a whole number found"),
        ("top", "kind = ['single']", "field kind: a string or nothing expected, a list found"),
        ("top", "seeds = ['a']", r"field seeds\[0\]: a whole number expected, a string found"),
        ("top", "seeds = [true]", r"seeds\[0\]: a whole number expected, true or false found"),
        ("top", "seeds = [-1]", "seed=-1; give 0 to"),
        ("top", "short = 3", "field short: a table or nothing expected"),
        ("grid", "max_steps = 3", "give a list of values"),
        ("grid", "curriculum = [['none']]", r"curriculum=\['none'\] in \[grid\]; give a name"),
        ("settings", "max_steps = {a = 1}", "give a number, a string, true or false"),
        ("settings", "max_steps = 2020-01-01", "give a number, a string, true or false"),
        ("settings", "max_steps = [1, 2]", "give a number, a string, true or false"),
        ("rest", "[report]\nx = 'bogus'", r"'bogus' in \[report\] is not a setting"),
        ("rest", "[report]\nx = 3", "field report.x: a string or nothing expected"),
        ("rest", "[report]\nx = 'variant'", r"'variant' in \[report\] is not a setting"),
        ("rest", "[report]\ngroup = [5]", r"report.group\[0\]: a string expected, a whole number"),
        ("rest", "[report]\ngroup = ['bogus']", r"'bogus' in \[report\] is not a setting"),
        (
            "rest",
            "[search]\ngamma = {low=0.1, high=0.9, scale='bogus'}",
            "scale='bogus'; give linear",
        ),
        ("rest", "[search]\ngamma = {low='a', high='b'}", "field low: a number expected"),
        ("rest", "[search]\ngamma = {low=0.1, high=inf}", "give finite numbers"),
        ("rest", "[search]\ngamma = {low=0.0, high=1, scale='log'}", "needs low above 0"),
        ("rest", "[search]\ngamma = {choices=3}", "field choices: a list expected"),
        ("rest", "[search]\ngamma = {choices=[0.5], scale='log'}", "unknown field 'scale'"),
        ("rest", "[search]\ngamma = 3", "search of gamma: a table expected"),
        ("rest", "[search]\nseed = 'a'\ngamma = {choices=[0.5]}", "seed='a' in"),
        ("rest", "[search]\nsamples = 1000000000\ngamma = {choices=[0.5]}", "from 1 to 100,000"),
        (
            "grid",
            f"num_games = {list(range(101))}\nmax_steps = {list(range(1001))}",
            "101,101 runs",
        ),
        ("top", "variants = [{name='a'}, {name='b', gamma=1.0}]", "'a' and .*'b' have equal"),
        ("grid", "gamma = [0.5]\n[search]\ngamma = {choices=[0.1]}", "'gamma' is set by two of"),
    ],
)
def test_settings_without_effect_or_that_fail_later_are_refused_with_one_line(
    part: str, text: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path, **{part: text})
    assert str(caught.value).startswith(str(tmp_path / "s.toml"))
    assert "\n" not in str(caught.value) and "|" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gamma = 0.5", "", "'a' and .*'b' have equal settings"),
        ("gamma = 0.5", "seed = 3", "variant 'b' sets seed"),
        ('name = "b"', "name = ['b']", "give each a different name"),
        ('control = "a"', "control = 3", "field control: a string or nothing expected"),
        ("[settings]", "[other]\n[settings]", "unknown field 'other'"),
        ("{rest}", "[report]\ngroup = ['gamma']", "one curve per variant; leave it out"),
        ("{rest}", "[report]\nx = 'gamma'", r"is not in \[grid\]"),
        ("{rest}", "[grid]\nseed = [0, 1]\n[report]\nx = 'seed'", "give seeds = "),
    ],
)
def test_ablation_files_are_validated_likewise(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    assert old in ABLATION
    path = tmp_path / "a.toml"
    path.write_text(ABLATION.replace(old, new).replace("{rest}", ""))
    with pytest.raises(ValueError, match=message):
        load_ablation(str(path))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("task = 'maze'", "no chasers or no evaders"),
        ("hyper = 1", "unknown setting 'hyper' of self-play"),
        ("curriculum = 'none'", "unknown setting 'curriculum' of self-play"),
    ],
)
def test_settings_that_self_play_does_not_have_are_one_line(
    setting: str, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "s.toml"
    file.write_text(f"kind = 'self-play'\n[settings]\nframes = 1000\n{setting}\n")
    with pytest.raises(ValueError, match=message):
        load_sweep(str(file))


def test_budgets_on_the_axis_are_settings_not_measurements(tmp_path: Path) -> None:
    grid, rest = "frames = [1000, 2000]", "[report]\nx = 'frames'"
    sweep = load(tmp_path, grid=grid, rest=rest)
    assert sweep.report == {"x": "budget_frames", "group": []}
    prepare(sweep, tmp_path / "out")
    runs, _ = collect(tmp_path / "out")
    assert sorted(runs["budget_frames"]) == [1000, 2000]


def test_a_dry_run_lists_the_runs_with_what_varies_and_does_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = load(tmp_path, grid="max_steps = [50, 60]")
    out = tmp_path / "out"
    main(["sweep", str(tmp_path / "s.toml"), "--out", str(out), "--dry-run"])
    assert not out.exists()
    prepare(sweep, out)
    folder = out / "runs" / sweep.runs[0].name
    (folder / "checkpoint.pt").write_bytes(b"")
    capsys.readouterr()
    main(["sweep", str(tmp_path / "s.toml"), "--out", str(out), "--dry-run"])
    first, second, last = capsys.readouterr().out.splitlines()
    assert first.split() == ["interrupted", "max_steps=50", "seed=0", str(folder)]
    assert second.split()[:3] == ["new", "max_steps=60", "seed=0"]
    assert last == f"2 runs into {out} (1 interrupted, 1 new); nothing was done"
    (tmp_path / "a.toml").write_text(ABLATION.replace("{rest}", ""))
    main(["ablate", str(tmp_path / "a.toml"), "--out", str(out / "none"), "--dry-run"])
    first, second, reach, last = capsys.readouterr().out.splitlines()
    assert "variant=a seed=0" in first and "gamma=0.5" in second and "2 new" in last
    assert "p < 0.05 cannot be reached: with 1 seeds" in reach
    for version, folder in ((), ""), (("--version", "short"), ""), (("--version", "full"), "-full"):
        main(["ablate", "opponent-epsilon", "--dry-run", *version])
        assert f" into ablations/opponent-epsilon{folder} (" in capsys.readouterr().out


# -- what a sweep keeps ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("[]", "a table expected, a list found"),
        ("{}", "field 'title' is missing"),
        ('{"title": 3}', "field title: a string expected"),
        ('{"title": "a", "runs": [1]}', "field runs[0]: a string expected"),
        ('{"title": "a", "group": null}', "field group: a list expected"),
        ("{", "damaged, not JSON"),
    ],
)
def test_a_damaged_plan_is_one_line(
    content: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = load(tmp_path)
    prepare(sweep, tmp_path / "out")
    (tmp_path / "out" / HINTS).write_text(content)
    with pytest.raises(SystemExit) as exit_:
        main(["report", str(tmp_path / "out")])
    told = capsys.readouterr().err
    assert exit_.value.code == 2 and len(told.splitlines()) == 1
    assert said in told and HINTS in told
    prepare(sweep, tmp_path / "out")  # the next sweep repairs it
    assert read_hints(tmp_path / "out").title == "s"


def test_damaged_labels_results_errors_and_progress_are_no_tracebacks(tmp_path: Path) -> None:
    sweep = load(tmp_path)
    prepare(sweep, tmp_path / "out")
    folder = tmp_path / "out" / "runs" / sweep.runs[0].name
    (folder / LABEL).write_text('{"maze": {"a": 1}}')
    with pytest.raises(ValueError, match=r"run\.json: .* expected, a table found"):
        read_label(folder)
    (folder / LABEL).unlink()
    (folder / "results.json").write_text(json.dumps({"frames": 3, "seconds": "many"}))
    with pytest.raises(ValueError, match=r"results\.json: .*; delete it"):
        collect(tmp_path / "out")
    (folder / "results.json").unlink()
    for content in (b"", b"\xff\xfe\n", b"boom\nmore"):
        (folder / ERROR).write_bytes(content)
        assert error_of(folder) in ("unknown", "\ufffd\ufffd", "boom")
        assert collect(tmp_path / "out")[0]["status"].to_list() == ["failed"]
    for text, share in (("0.25", 0.25), ("nan", 0.0), ("1e99", 1.0), ("x", 0.0), ("-3", 0.0)):
        (folder / PROGRESS).write_text(text)
        assert progress_of(folder) == share
