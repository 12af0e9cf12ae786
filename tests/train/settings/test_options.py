"""Options without effect are refused, and resumed runs keep the options of their first command."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from self_play_runs import make_settings, side_by

from train.commands.main import main
from train.kinds import open_run, start, write_config
from train.runs.folder import RUN, SELF_PLAY
from train.runs.parts import settings_of
from train.runs.unused_settings import check_unused_settings

TINY = [
    *("--task", "maze", "--num-goals", "1", "--maze", "3x3", "--algorithm", "q_learning"),
    *("--num-games", "16", "--threads", "1"),
]
PLAY = ["self-play", "--maze", "3x3", "--frames", "64", "--out", "OUT"]
DQN = [*PLAY, "--algorithm", "dqn"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "run"
    main(["train", *TINY, "--frames", "512", "--episodes", "20", "--out", str(folder)])
    return folder


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["train", *TINY, "--frames", "64", "--opponent-epsilon", "0.5"], "no other agent"),
        (["train", "--frames", "64", "--rewards", "runner.goal=2"], "has no runner"),
        ([*PLAY, "--sampling", "latest", "--window", "9"], "window=9 has no effect"),
        ([*PLAY, "--sampling", "uniform", "--pfsp-power", "3"], "pfsp_power=3.0 has no effect"),
        ([*PLAY, "--opponent", "astar"], "--opponent is for `pursuit train`; use --chaser"),
        ([*DQN, "--clip", "0.3"], "Unrecognized options: --clip"),
        (["baseline", *TINY[:4], "--opponent-epsilon", "0.5"], "no other agent"),
        (["evaluate", "RUN", "--opponent-epsilon", "0.5"], "no other agent"),
        (["render", "RUN", "--maze", "5x5", "--out", "OUT"], "--maze with"),
        (["render", "RUN", "--num_goals=1", "--out", "OUT"], "--num-goals with"),
        (["maze", "5x5", "--height", "7"], "height=7 has no effect: it is an option of --generate"),
        (["maze", "5x5", "--seed", "3"], "seed=3 has no effect"),
        (["sweep", "maze_by_size", "--address", "auto", "--out", "OUT"], "address='auto'"),
        (["sweep", "--list", "bogus"], "'bogus' with --list"),
        (["solve", "--view-radius", "1", "--num-chasers", "2"], "num_chasers=2 has no effect"),
        (["solve", "--view-radius", "1", "--horizon", "9"], "horizon=9 has no effect"),
        (["solve", "--view-radius", "1", "--seconds", "-3"], "seconds=-3.0"),
        (["solve", "--role", "bogus"], "unknown role 'bogus'"),
        (["solve", "--seconds", "-3"], "seconds=-3.0"),
        (["solve", "--opponent-epsilon", "7"], "opponent_epsilon=7.0"),
        (["solve", "--role", "evader"], "role='evader' has no effect: it is an option of --view"),
        (["solve", "--horizon", "9", "--discount", "0.9"], "discount=0.9 has no effect"),
        (["solve", "--method", "shapley"], "unknown method 'shapley'"),
        (["solve", "--method", "double-oracle", "--horizon", "9"], "horizon=9 has no effect"),
        (["solve", "--method", "fictitious-play", "--out", "OUT"], "without a figure"),
        (["solve", "--method", "double-oracle", "--discount", "1"], "discount=1.0"),
        (["solve", "--num-chasers", "2", "--out", "OUT"], "the figure is for one chaser only"),
    ],
    ids=lambda value: " ".join(value[:1] + value[-3:]) if isinstance(value, list) else "",
)
def test_options_without_effect_are_one_line(
    command: list[str], message: str, trained: Path, tmp_path: Path, capsys: Any
) -> None:
    places = {"RUN": str(trained), "OUT": str(tmp_path / "out.gif")}
    if command[0] == "train":
        command = [*command, "--out", "OUT"]
    assert message in error_of(capsys, *(places.get(word, word) for word in command))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "command, said",
    [
        (["self-play", "--episode-steps", "100000000000"], "give at most 200"),
        (["self-play", "--max-steps", "9", "--episode-steps", "10"], "give at most 9"),
        (["train", "--curriculum", "learning-progress", "--num-stages", "100000000000"], "to 1000"),
        (
            ["train", "--task", "maze", "--maze", "suite:5x5-train/0-9", "--num-goals", "1",
             "--observation", "planes", "--curriculum", "maze-replay", "--num-scored", "11"],
            "give at most 10",
        ),
    ],
    ids=lambda value: value[-2] if isinstance(value, list) else "",
)  # fmt: skip
def test_numbers_above_their_limit_are_refused(
    command: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in error_of(capsys, *command, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_settings_with_an_effect_or_at_their_defaults_are_taken() -> None:
    for settings in (
        make_settings(sampling="window", window=3, pool_size=9),
        make_settings(sampling="pfsp", pfsp_power=1.0),
        make_settings(episode_steps=200),
        make_settings(chaser=side_by("dqn", gamma=0.9), evader="astar"),
        settings_of(task="race", maze="3x3", opponent_epsilon=0.7, frames=64),
        settings_of(rewards="step=-1,chaser.capture=3", maze="3x3", frames=64),
        settings_of(rewards="evader.step=1", maze="3x3", frames=64),
    ):
        check_unused_settings(settings)


def test_runs_that_were_saved_with_settings_without_effect_go_on(tmp_path: Path) -> None:
    single = settings_of(task="maze", maze="3x3", opponent_epsilon=0.7, frames=64)
    pair = make_settings(sampling="latest", window=9)
    cases: list[tuple[str, Any]] = [(RUN, single), (SELF_PLAY, pair)]
    for kind, settings in cases:
        with pytest.raises(ValueError, match="has no effect"):
            start(kind, settings, tmp_path / "new")
        (tmp_path / kind).mkdir()
        write_config(kind, settings, tmp_path / kind)
        run = open_run(tmp_path / kind)
        assert run.trainee.frames == 0
        run.lock.release()


@pytest.mark.parametrize("command", ["train", "self-play"])
def test_a_resumed_run_keeps_the_final_evaluation_of_its_first_command(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = TINY if command == "train" else ["--maze", "3x3", "--num-games", "64"]
    given = [*given, "--minibatch-size", "512"] if command == "self-play" else given
    out, asked = tmp_path / "run", list[Any]()

    class Stop(Exception):
        """Ends the command before it trains."""

    def stop(run: Any, final: Any, *_: Any) -> None:
        asked.append((final.episodes, final.exact_seconds))
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr("train.commands.progress.finish_run", stop)
        for options in (
            [
                *given,
                "--frames",
                "512",
                "--episodes",
                "7",
                "--exact-seconds",
                "9",
                "--out",
                str(out),
            ],
            ["--resume", str(out)],
            ["--resume", str(out), "--episodes", "1000"],
            ["--resume", str(out), "--exact-seconds", "0"],
        ):
            with pytest.raises(Stop):
                main([command, *options])
    final = json.loads((out / "config.json").read_text())["final"]
    assert final == {"episodes": 7, "exact_seconds": 9.0}
    assert asked == [(7, 9.0), (7, 9.0), (1000, 9.0), (7, 0.0)]
    main([command, "--resume", str(out)])
    assert (out / "learning_curve.svg").exists()


FORMS = [
    "train",
    "train --task maze --algorithm dqn --curriculum goal-spread-start",
    "train --task reacher --algorithm td3",
    "train --game soccer --algorithm q_learning",
    "self-play",
    "self-play --algorithm dqn",
    "self-play --game soccer",
]
APPLIED = {"--help", "--resume", "--episodes", "--exact-seconds", "--report", "--no-report"}
APPLIED |= {"--allow", "--help-all", "--frames", "--seconds", "--stretch", "--quiet"}


@pytest.mark.parametrize("form", FORMS)
def test_every_option_that_a_resumed_run_does_not_apply_is_refused_by_name(
    form: str, trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([*form.split(), "--help-all"])
    names = {*re.findall(r"(?<![\w-])--[a-z][\w.-]*\w", capsys.readouterr().out)}
    assert len(names) > 30
    command = form.split()[0]
    if command == "self-play":
        names |= {"--chaser.entropy-coef", "--evader.algorithm"}
    for name in sorted(names - APPLIED):
        for given in ([name, "1"], [f"{name.replace('-', '_').replace('__', '--', 1)}=1"]):
            told = error_of(capsys, command, "--resume", str(trained), *given)
            assert f"--resume {trained} with {name}: a run is resumed with its own" in told
    several = ["--width", "9", "--episodes", "2", "--seed=3"]
    told = error_of(capsys, command, *several, "--resume", str(trained))
    assert "with --width, --seed: a run" in told
