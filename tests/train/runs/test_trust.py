"""Modules named in files are imported only if the user allows it; provenance is recorded."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import sys
import tarfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from self_play_runs import make_run

import pursuit
from pursuit import plugins as parts
from pursuit.tasks.rewards import REWARDS
from train.commands.main import main
from train.experiments.identity import fingerprint
from train.experiments.rows import read_run
from train.families.maze_policies import MAZE_POLICIES
from train.families.policies import loaded_policy
from train.files import write_json
from train.kinds import open_run, read_settings, resume, start
from train.runs.folder import RUN, read_config
from train.runs.opponents import SAVED, load_policy
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
    for name in ("_allowed", "_named"):
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
    parts._named.clear()


# -- untrusted files -------------------------------------------------------------------------------


SYNTAXES = (
    "stranger:Ok",
    "stranger:Ok+id",
    "walls+stranger:Ok",
    "stranger:Ok(size=3)",
    "stranger:Ok,A",
    "openspiel:stranger:Ok",
    "maze_game(maze='2x2', rewards='stranger:Ok')",
    "maze_game(maze='2x2', rewards='stran' 'ger:Ok')",
    "maze_game(maze='2x2', rewards='stranger\\x3aOk')",
    ["stranger:Ok"],
    {"stranger:Ok": "stranger:Ok"},
)
"""Ways to write a name in a file."""
READERS = (
    "evaluate {run} --episodes 2",
    "view {run} --out page.html",
    "render {run} --out a.gif",
    "export {run} --out a.onnx",
    "league {run} astar --games 2",
    "report {run} --out report",
    "train --resume {run}",
    "self-play --resume {run}",
    "baseline --opponent {run} --episodes 2",
    "solve --game {run}",
    "sweep {run}/config.json --dry-run",
)
STUDY_KEYS = (
    ["settings"],
    ["grid"],
    ["search"],
    ["variants", 0],
    ["tuning"],
    ["tuning", "settings"],
)
STUDY: dict[str, Any] = {
    "settings": {"seconds": 1},
    "variants": [{"name": "a"}, {"name": "b"}],
    "grid": {}, "search": {},
}  # fmt: skip
STUDY_TUNING = {
    "space": {"all": {"learning_rate": [0.1, 0.2]}}, "mazes": ["3x3"], "settings": {},
    "short": {"samples": 2, "frames": 10}, "full": {"samples": 2, "frames": 10},
}  # fmt: skip


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that exists once `stranger.py`, in the working folder, has been imported."""
    path = tmp_path / "sprung"
    (tmp_path / "stranger.py").write_text(f"open({str(path)!r}, 'w')\nOk = dict\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return path


def places_of(content: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The places of all values in nested plain values that may be a text."""
    if isinstance(content, dict | list):
        pairs = content.items() if isinstance(content, dict) else enumerate(content)
        for key, value in pairs:
            yield from places_of(value, (*above, key))
    if isinstance(content, str | list | dict | None) and above:
        yield above


def with_value(content: Any, place: tuple[Any, ...], value: Any) -> Any:
    found = json.loads(json.dumps(content))
    inner = found
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return found


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return (
            "{" + ", ".join(f"{json.dumps(key)} = {toml(own)}" for key, own in value.items()) + "}"
        )
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value)


def tried(*arguments: str) -> None:
    """Run a command, which may refuse its input in one line."""
    with contextlib.suppress(SystemExit):
        main(arguments)


def old_folders(out: Path) -> list[Path]:
    """The folders of an earlier version: every kind of run, and studies."""
    archive = sorted((Path(__file__).parents[2] / "old_folders").glob("*.tar.xz"))[-1]
    with tarfile.open(archive) as tar:
        tar.extractall(out, filter="data")
    return sorted(out.iterdir())


@pytest.mark.slow
def test_no_setting_of_a_run_imports_a_name(
    trap: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every value in every syntax; one command after the other reads them."""
    number, known = 0, set[tuple[Any, ...]]()
    for file in sorted(path / "config.json" for path in old_folders(tmp_path / "old")):
        if not file.exists():
            continue
        content = json.loads(file.read_text())
        read_settings(file.parent)
        for place in places_of(content):
            if place in known:
                continue
            known.add(place)
            for value in SYNTAXES:
                write_json(file, with_value(content, place, value))
                with contextlib.suppress(ValueError):
                    read_settings(file.parent)
                assert not trap.exists(), (place, value)
            reader = READERS[number % len(READERS)].format(run=file.parent)
            number += 1
            write_json(file, with_value(content, place, SYNTAXES[number % len(SYNTAXES)]))
            tried(*reader.split())
            assert not trap.exists(), (place, reader)
        write_json(file, content)
    assert number > 50 and "stranger" not in sys.modules


@pytest.mark.slow
def test_no_setting_in_a_study_file_imports_a_name(
    trap: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old_folders(tmp_path / "old")
    configs = [json.loads(p.read_text()) for p in tmp_path.glob("old/*/config.json")]
    names = {place[-1] for config in configs for place in places_of(config)}
    assert {"rewards", "critic_observation", "sampling", "game"} <= names
    commands = "sweep s.toml --dry-run", "ablate s.toml --dry-run", "compare s.toml --dry-run"
    texts = sorted(name for name in names | {"games", "contestant"} if isinstance(name, str))
    for number, (name, value) in enumerate(itertools.product(texts, SYNTAXES)):
        table = STUDY_KEYS[number % len(STUDY_KEYS)]
        content = json.loads(json.dumps(STUDY))
        if table[0] == "tuning":
            content["tuning"] = json.loads(json.dumps(STUDY_TUNING))
        inner: Any = content
        for key in table:
            inner = inner[key]
        inner[name] = [value] if table[0] in ("grid", "search") else value
        Path("s.toml").write_text("\n".join(f"{key} = {toml(own)}" for key, own in content.items()))
        tomllib.loads(Path("s.toml").read_text())
        tried(*commands[number % len(commands)].split())
        assert not trap.exists(), (name, value, table)
    assert "stranger" not in sys.modules


def test_no_code_named_in_an_untrusted_file_is_run(
    trap: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = start(RUN, settings_of(**FLAT), tmp_path / "run")
    run.train()
    run.results(2)
    good = json.loads(Path("run/config.json").read_text())
    for place in (("task", "rewards"), ("task", "opponent"), ("observation",), ("algorithm",),
                  ("curriculum",)):  # fmt: skip
        write_json(tmp_path / "run/config.json", with_value(good, place, "stranger:pay"))
        for read in (load_settings, load_policy, open_run, lambda path: resume(path, RUN)):
            with pytest.raises(ValueError, match=r"config\.json: names 'stranger:pay'"):
                read(tmp_path / "run")  # type: ignore[operator]
        for command in READERS[:9]:
            if "self-play" not in command:
                said = error_of(capsys, *command.format(run="run").split())
                assert "config.json: names 'stranger:pay'" in said and "--allow stranger" in said
    Path("sweep.toml").write_text(SWEEP.format(name="stranger:pay"))
    assert "toml: names 'stranger:pay'" in error_of(capsys, "sweep", "sweep.toml", "--dry-run")
    Path("model.zip").write_bytes(b"")
    task = with_value(good, ("task", "rewards"), "stranger:pay")["task"]
    write_json(description_of(Path("model.zip")), {"task": task, "observation": "one_hot"})
    with pytest.raises(ValueError, match=r"model\.json: task: names 'stranger:pay'"):
        load_stable_baselines(Path("model.zip"))
    write_json(
        description_of(Path("model.zip")), {"task": good["task"], "observation": "stranger:Ok"}
    )
    for load in (
        load_stable_baselines,
        lambda path: loaded_policy(MAZE_POLICIES, SAVED, path, task=None),
    ):
        with pytest.raises(ValueError, match=r"names 'stranger:Ok'|model\.zip: damaged"):
            load(Path("model.zip"))
    assert not trap.exists() and "stranger" not in sys.modules
    write_json(tmp_path / "run/config.json", with_value(good, ("observation",), "stranger:pay"))
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
    main(["evaluate", "pair"])
    assert "NashConv" in capsys.readouterr().out
    for command, told in (
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


def test_what_code_of_the_user_names_is_not_from_a_file(
    module: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command of one's own, and a module that names another one when it is imported."""
    Path("mine.py").write_text(
        "from pursuit.tasks.rewards import REWARDS\n"
        f"FOUND = REWARDS.get('{module}:pay')\n"
        f"def run(rest):\n    print(REWARDS.get('{module}:pay') is FOUND)\n"
    )
    main(["mine:run"])
    assert capsys.readouterr().out == "True\n"
    forgotten(module)
    with parts.reading("a file", ["mine:FOUND"]):
        assert callable(REWARDS.get("mine:FOUND"))


def test_the_environment_allows_as_well(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(name: str) -> None:
        with parts.reading("a file"):
            REWARDS.get(name)

    with pytest.raises(ValueError, match=r"a file: .* --allow a \(.*allow\('a'\), .*=a\)"):
        read("a.deep:f")
    with pytest.raises(ValueError, match="a file: names"):
        read(f"{module}:pay")
    monkeypatch.setenv(parts.ALLOW, f"other, {module}")
    read(f"{module}:pay")
    monkeypatch.delenv(parts.ALLOW)
    read(f"{module}:pay")  # this process has it already
    forgotten(module)
    with parts.reading("a file", ["--rewards", f"game(x='{module}:pay')"]):  # named by the user
        REWARDS.get(f"{module}:pay")


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
