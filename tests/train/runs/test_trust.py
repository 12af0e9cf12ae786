"""Modules named in files are imported only if the user allows it; provenance is recorded."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from self_play_runs import make_run

import pursuit
from pursuit import plugins as parts
from train.commands.main import main
from train.experiments.identity import fingerprint
from train.experiments.rows import read_run
from train.files import write_json
from train.kinds import open_run, resume, start
from train.runs.folder import RUN, read_config
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.runs.provenance import provenance
from train.runs.saved import load_settings
from train.runs.stable_baselines import description_of, load_stable_baselines

REWARD = "def pay(before, actions, after):\n    return after.rewards * {scale}\n"
FLAT: dict[str, Any] = {
    "maze": "2x2", "max_steps": 20, "algorithm": "q_learning", "frames": 64 * 64, "num_games": 64,
}  # fmt: skip
SWEEP = """
episodes = 4
[settings]
maze = "2x2"
algorithm = "q_learning"
num_games = 64
frames = 4096
rewards = "{name}"
"""


@pytest.fixture(autouse=True)
def nothing_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_allowed", "_resolved"):
        monkeypatch.setattr(parts, name, set())
    monkeypatch.setattr(parts, "_folders", [])
    monkeypatch.setattr(sys, "path", [*sys.path])


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> str:
    """The name of a user's module with a reward function `pay`, another one in every test."""
    name = f"rewards_{hashlib.sha256(request.node.name.encode()).hexdigest()[:8]}"
    home = tmp_path / "home"
    home.mkdir()
    (home / f"{name}.py").write_text(REWARD.format(scale=2))
    monkeypatch.chdir(home)
    monkeypatch.syspath_prepend(str(home))
    return name


def edited(module: str, scale: int) -> None:
    """The module's source has changed, and is read again."""
    Path(f"{module}.py").write_text(REWARD.format(scale=scale))
    sys.modules.pop(module, None)


def forgotten(module: str) -> None:
    """As in a new process."""
    sys.modules.pop(module, None)
    parts._resolved.clear()


# -- untrusted files -------------------------------------------------------------------------------


def test_no_code_named_in_an_untrusted_file_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """However it is read: every name in every file, and every command."""
    trap = tmp_path / "sprung"
    (tmp_path / "stranger.py").write_text(f"open({str(trap)!r}, 'w')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    run = start(RUN, settings_of(**FLAT), tmp_path / "run")
    run.train()
    run.results(2)
    good = json.loads(Path("run/config.json").read_text())
    for place in (("task", "rewards"), ("task", "opponent"), ("observation",), ("algorithm",),
                  ("curriculum",), ("curriculum_settings", "axis"), ("anything",)):  # fmt: skip
        bad = json.loads(json.dumps(good))
        inner = bad
        for name in place[:-1]:
            inner = inner[name]
        inner[place[-1]] = "stranger:pay"
        write_json(tmp_path / "run/config.json", bad)
        for read in (load_settings, load_policy, open_run, lambda path: resume(path, RUN)):
            with pytest.raises(ValueError, match=r"config\.json: names 'stranger:pay'"):
                read(tmp_path / "run")  # type: ignore[operator]
    for command in ("evaluate run", "render run --out a.gif", "league run astar",
                    "train --resume run", "baseline --opponent run"):  # fmt: skip
        assert "add --allow stranger" in error_of(capsys, *command.split())
    Path("sweep.toml").write_text(SWEEP.format(name="stranger:pay"))
    Path("ablation.toml").write_text('[[variants]]\nname = "a"\nrewards = "stranger:pay"\n')
    for command in ("sweep sweep.toml --dry-run", "ablate ablation.toml --dry-run"):
        assert "toml: names 'stranger:pay'" in error_of(capsys, *command.split())
    Path("model.zip").write_bytes(b"")
    description = {"task": {"rewards": "stranger:pay"}, "observation": "one_hot"}
    write_json(description_of(Path("model.zip")), description)
    with pytest.raises(ValueError, match=r"model\.json: names 'stranger:pay'"):
        load_stable_baselines(Path("model.zip"))
    assert not trap.exists() and "stranger" not in sys.modules
    parts.allow("strange")  # another module, whose name is only like it
    with pytest.raises(ValueError, match="stranger"):
        load_settings(tmp_path / "run")


def test_leagues_and_evaluations_do_not_ask_for_a_sampling_rule(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    make_run(tmp_path / "pair", frames=2000).train()
    config = json.loads(Path("pair/config.json").read_text())
    write_json(Path("pair/config.json"), {**config, "sampling": "stranger:rule"})
    main(["league", "pair", "astar", "--games", "2"])
    for command, told in (
        ("evaluate pair", "give pair/chaser or pair/evader"),
        ("self-play --resume pair", "add --allow stranger"),
        ("league pair astar --maze 7x7", "maze='7x7', but pair has its own maze"),
    ):
        assert told in error_of(capsys, *command.split())


def test_allowed_modules_are_imported(module: str, tmp_path: Path, capsys: Any) -> None:
    run = start(RUN, settings_of(**FLAT, rewards=f"{module}:pay"), tmp_path / "run")
    run.train()
    run.results(2)
    forgotten(module)
    assert f"--allow {module}" in error_of(capsys, "evaluate", tmp_path / "run", "--episodes", 2)
    main(["evaluate", str(tmp_path / "run"), "--episodes", "2", "--allow", module])
    assert "learned" in capsys.readouterr().out
    forgotten(module)
    parts._allowed.clear()
    play = ("play", "--against", tmp_path / "run", "--beside", "nobody", "--allow", module)
    assert "'nobody': not a policy" in error_of(capsys, *play)  # all that comes before succeeds
    forgotten(module)
    pursuit.allow(module)
    assert load_settings(tmp_path / "run").task.rewards == f"{module}:pay"
    for wrong in ("", "a b", "../x"):
        with pytest.raises(ValueError, match="give the name of a module"):
            pursuit.allow(wrong)


def test_the_environment_allows_as_well(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parts.check_trusted("a file", {"maze": "C:x/y", "schedule_points": "0:1,0.5:0.2"})
    with pytest.raises(ValueError, match=r"--allow a --allow b \(.*allow\('a', 'b'\), .*=a,b\)"):
        parts.check_trusted("a file", {"rewards": "a:f", "members": ["b.deep:f", "a:g"]})
    with pytest.raises(ValueError, match="a file: names"):
        parts.check_trusted("a file", [{"members": ["astar", f"{module}.deep:f"]}])
    monkeypatch.setenv(parts.ALLOW, f"other, {module}")
    parts.check_trusted("a file", [{"members": ["astar", f"{module}.deep:f"]}])


# -- provenance ------------------------------------------------------------------------------------


def test_a_run_records_the_source_of_its_parts(module: str, tmp_path: Path, recwarn: Any) -> None:
    settings = settings_of(**FLAT, rewards=f"{module}:pay")
    folder = tmp_path / "run"
    run = start(RUN, settings, folder)
    run.train(lambda run, row: setattr(run, "stopped", run.progress >= 0.5))
    digest = hashlib.sha256(Path(f"{module}.py").read_bytes()).hexdigest()
    said = {"rewards": {"name": f"{module}:pay", "sha256": digest}}
    assert json.loads((folder / "config.json").read_text())["parts"] == said == provenance(settings)
    assert run.results(2)["parts"] == said
    assert "parts" not in read_config(folder)[1] and "command" not in read_config(folder)[1]
    before = fingerprint(RUN, settings, 4, {})
    assert load_settings(folder) == settings and not recwarn.list

    edited(module, scale=3)
    assert fingerprint(RUN, settings, 4, {}) != before
    with pytest.warns(UserWarning, match=f"the source of {module} has changed"):
        load_policy(folder)
    with pytest.warns(UserWarning, match=f"the source of {module} has changed"):
        read_run(folder)[0]
    with pytest.raises(
        ValueError, match="changed since this run started; restore it, or start a new"
    ):
        resume(folder, RUN)
    edited(module, scale=2)
    assert resume(folder, RUN).progress >= 0.5


def test_a_package_is_hashed_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "my_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "inner.py").write_text(REWARD.format(scale="SCALE") + "from .numbers import SCALE\n")
    (package / "numbers.py").write_text("SCALE = 2\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    settings = settings_of(**FLAT, rewards="my_package.inner:pay")
    first = provenance(settings)["rewards"]["sha256"]
    (package / "numbers.py").write_text("SCALE = 3\n")
    assert provenance(settings)["rewards"]["sha256"] != first
    assert provenance(settings_of(**FLAT)) == {}


def test_the_command_is_recorded_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, (argv, told) in enumerate(
        ((["pursuit", "train", "--out", "a b"], "pursuit train --out 'a b'"), ([""], "Python"))
    ):
        monkeypatch.setattr(sys, "argv", argv)
        start(RUN, settings_of(**FLAT), tmp_path / str(number))
        assert json.loads((tmp_path / str(number) / "config.json").read_text())["command"] == told


# -- other processes and machines ------------------------------------------------------------------


def test_workers_allow_the_same_modules_as_their_sweep(module: str) -> None:
    settings_of(**FLAT, rewards=f"{module}:pay")  # named by the user
    pursuit.allow(module)
    found = parts.environment()
    assert found[parts.ALLOW] == module and str(Path.cwd()) in found[parts.LOOK_IN]


@pytest.mark.slow
def test_a_sweep_of_own_parts_runs_in_its_workers(module: str, tmp_path: Path) -> None:
    """From the folder that the module is in; a train.py there does not stand in for ours."""
    Path("train.py").write_text("raise SystemExit('the wrong one')\n")
    Path("sweep.toml").write_text(SWEEP.format(name=f"{module}:pay"))
    main(["sweep", "sweep.toml", "--out", str(tmp_path / "out"), "--allow", module])
    (folder,) = (tmp_path / "out").glob("runs/*")
    assert read_run(folder)[0]["status"] == "complete"
    # A report is made of the results alone: anywhere, without the module.
    Path(f"{module}.py").unlink()
    forgotten(module)
    parts._allowed.clear()
    assert read_run(folder)[0]["rewards"] == f"{module}:pay" and module not in sys.modules
