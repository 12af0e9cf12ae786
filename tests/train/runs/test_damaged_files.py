"""Damaged or malicious files of a run are refused with one line."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import pickle
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from train.experiments.rows import read_run
from train.kinds import open_run, start
from train.runs.folder import (
    RUN,
    SELF_PLAY,
    is_complete,
    load_checkpoint,
    load_results,
    read_metrics,
)
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.runs.saved import load_settings
from train.self_play.league import enter
from train.self_play.parts import self_play_settings_of
from train.tensors import MARK, first_not_finite, write_tensors

SMALL = {"maze": "2x2", "num_games": 16, "rollout_steps": 8, "width": 8, "threads": 1}
PPO = {**SMALL, "minibatch_size": 64, "frames": 1024}
OF_ALGORITHM = {"maze": "2x2", "num_games": 8, "width": 8, "threads": 1, "frames": 1024}
NASTY: list[Any] = [
    *(None, True, -1, 0, 3, 1e308, -0.5, 10**40, "", "x", [], {}, [[]], {"a": 1}, [1, "a"]),
    *(float("nan"), float("inf")),
]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Complete runs, one of every kind of file."""
    made = {
        "levels": (RUN, settings_of(**PPO, task="maze", num_goals=1, curriculum="level-replay")),
        "dqn": (
            RUN,
            settings_of(
                **SMALL, algorithm="dqn", frames=1024, buffer_size=300, batch_size=16,
                learning_starts=64,
            ),
        ),
        "table": (RUN, settings_of(maze="2x2", algorithm="q_learning", num_games=8, frames=1024)),
        "self-play": (SELF_PLAY, self_play_settings_of(**PPO, snapshots=2, members=["astar"])),
    }  # fmt: skip
    folders = {}
    for name, (kind, settings) in made.items():
        folders[name] = tmp_path_factory.mktemp("damaged") / name
        run = start(kind, settings, folders[name])
        run.train()
        run.results(2)
    return folders


def iterate(folder: Path) -> None:
    """Open a run and let it learn on for a moment."""
    run = open_run(folder)
    run.trainee.iterate(run)
    run._check_learned()
    run.trainee.close()


def enter_league(folder: Path) -> None:
    """Take part in a league."""
    enter([str(folder), "astar"], "2x2")


READERS: dict[str, list[Callable[[Path], object]]] = {
    "config.json": [
        load_settings,
        load_policy,
        open_run,
        read_run,
        lambda f: enter([str(f), "astar"], "2x2"),
    ],
    "results.json": [is_complete, load_results, read_run],
    "metrics.csv": [read_metrics, open_run, lambda f: (load_results(f), read_run(f))],
    "checkpoint.pt": [load_policy, iterate],
    ".pt": [open_run],
}


def readers_of(path: Path) -> list[Callable[[Path], object]]:
    return READERS.get(path.name, READERS[".pt"])


def places_in(content: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """A path in nested dicts and lists."""
    inner: Any = ()
    if isinstance(content, dict):
        inner = content.items()
    elif isinstance(content, list):
        inner = enumerate(content)
    found = [path] if path else []
    for name, part in inner:
        found += places_in(part, (*path, name))
    return found


def changed(content: Any, chance: random.Random) -> Any:
    """Replace, remove or add a random entry."""
    *way, last = chance.choice(places_in(content))
    holder = content
    for name in way:
        holder = holder[name]
    deed = chance.randrange(6)
    if deed == 0:
        del holder[last]
    elif deed == 1 and isinstance(holder, dict):
        holder["new"] = chance.choice(NASTY)
    else:
        holder[last] = chance.choice(NASTY)
    return content


def damage(path: Path, chance: random.Random) -> None:
    """One of many ways to damage a file."""
    raw = bytearray(path.read_bytes())
    deed = chance.randrange(10 if path.suffix != ".pt" else 4)
    if deed == 0:
        path.unlink()
    elif deed == 1:
        path.write_bytes(raw[: chance.randrange(len(raw))])
    elif deed == 2:
        for _ in range(chance.randint(1, 3)):
            raw[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)
        path.write_bytes(raw)
    elif deed == 3:
        place = chance.randrange(len(raw))
        junk = chance.choice([b"\0", b"\xff\xfe", b"[[{", b'"'])
        path.write_bytes(raw[:place] + junk + raw[place:])
    elif path.suffix == ".json":
        text = json.dumps(changed(json.loads(raw), chance))
        path.write_text("[" * 100_000 if chance.random() < 0.05 else text)
    elif path.suffix == ".csv":
        rows = list(csv.reader(io.StringIO(raw.decode())))
        row, column = chance.randrange(len(rows)), chance.randrange(len(rows[0]))
        if chance.random() < 0.3:
            rows = [[c for n, c in enumerate(cells) if n != column] for cells in rows]
        elif chance.random() < 0.3:
            rows[row] = rows[row][:column]
        else:
            rows[row][column] = chance.choice(["", "x", "nan", "1e999", "-1", rows[0][0]])
        path.write_text("\n".join(",".join(cells) for cells in rows))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*snapshot, left out of the pool")
def test_damage_to_a_file_is_reported_in_one_line(runs: dict[str, Path], tmp_path: Path) -> None:
    """Every reader succeeds, or reports one line with the folder."""
    chance = random.Random(0)
    for number in range(120):
        name = chance.choice(list(runs))
        folder = tmp_path / "run"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(runs[name], folder)
        files = [p for p in folder.rglob("*") if p.suffix in (".json", ".csv", ".pt")]
        path = chance.choice(sorted(files))
        damage(path, chance)
        where = path.parent if path.parent.name in ("chaser", "evader") else folder
        if where.parent.name == "pool":
            where = folder
        for reader in readers_of(path):
            try:
                reader(where)
            except ValueError as error:
                told = str(error)
                assert "\n" not in told and len(told) < 600, told
                assert str(folder) in told, told
            except Exception as error:
                told = f"damage {number} to {name}, {path.name}: {error!r}"
                raise AssertionError(told) from error


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("table", {"reference": True}),
        ("table", {"teammates": {"chaser_1": 3}}),
        ("table", {"evaluation": {"optimal_steps": None}}),
        ("self-play", {"discount": "0.99"}),
        ("self-play", {"team": [1]}),
        ("self-play", {"exact_best_response": {"chaser": "x"}}),
    ],
)
def test_results_edited_by_hand_are_refused_where_they_are_read(
    name: str, changes: dict[str, Any], runs: dict[str, Path], tmp_path: Path
) -> None:
    content = json.loads((runs[name] / "results.json").read_text())
    for key, value in changes.items():
        content[key] = content.get(key, {}) | value if key == "evaluation" else value
    (tmp_path / "results.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=rf"results\.json.*{min(changes)}.*; delete it and resume"):
        load_results(tmp_path)


def test_a_flipped_bit_anywhere_in_a_checkpoint_is_noticed(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    raw = (runs["table"] / "checkpoint.pt").read_bytes()
    chance = random.Random(0)
    for place in [0, len(raw) - 1, *(chance.randrange(len(raw)) for _ in range(50))]:
        hurt = bytearray(raw)
        hurt[place] ^= 1 << chance.randrange(8)
        (tmp_path / "checkpoint.pt").write_bytes(hurt)
        with pytest.raises(ValueError, match=r"checkpoint.pt: damaged.*checksum does not match"):
            load_checkpoint(tmp_path)


class Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return (os.mkdir, ("owned",))


def torch_file(content: Any) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"weights",
        pickle.dumps({"format": 1, "network": Evil()}),
        torch_file({"format": 6, "trainee": Evil()}),
        torch_file({"format": 2, "learner": {"network": {"layer": torch.zeros(3)}}}),
    ],
    ids=["empty", "text", "code", "code of torch", "other"],
)
@pytest.mark.parametrize("checksum", [False, True])
def test_a_foreign_or_malicious_checkpoint_is_an_error_and_runs_no_code(
    content: bytes, checksum: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    end = MARK + hashlib.sha256(content).digest() if checksum else b""
    (tmp_path / "checkpoint.pt").write_bytes(content + end)
    with pytest.raises(ValueError, match=r"checkpoint\.pt: ") as caught:
        load_checkpoint(tmp_path)
    assert "\n" not in str(caught.value) and not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    "text", ["{", "[]", "{}", '{"task": {"maze": 7}}', '{"task": {}, "ppo": {}, "x": 1}']
)
def test_a_damaged_config_is_an_error(text: str, runs: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(runs["table"], tmp_path / "run"))
    (folder / "config.json").write_text(text)
    for read in (load_settings, load_policy):
        with pytest.raises(ValueError, match=str(folder)) as caught:
            read(folder)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "other"),
    [("levels", "dqn"), ("dqn", "table"), ("table", "self-play"), ("self-play", "levels")],
)
def test_the_checkpoint_of_another_run_is_refused(
    name: str, other: str, runs: dict[str, Path], tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(runs[name], tmp_path / "run"))
    open_run(folder).lock.release()
    shutil.copy(runs[other] / "checkpoint.pt", folder)
    for read in (open_run, load_policy) if name != "self-play" else (open_run,):
        with pytest.raises(ValueError, match="does not match the settings") as caught:
            read(folder)
        assert "\n" not in str(caught.value)


def test_the_checkpoint_of_another_algorithm_with_the_same_network_is_refused(
    tmp_path: Path,
) -> None:
    for name in ("a2c", "reinforce"):
        start(RUN, settings_of(**OF_ALGORITHM, algorithm=name), tmp_path / name).save()
        load_policy(tmp_path / name)
    shutil.copy(tmp_path / "a2c" / "checkpoint.pt", tmp_path / "reinforce")
    said = "algorithm 'a2c' instead of 'reinforce'"
    for read in (open_run, load_policy):
        with pytest.raises(ValueError, match=f"does not match the settings.*{said}") as caught:
            read(tmp_path / "reinforce")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("levels", float("nan")),
        ("dqn", float("inf")),
        ("table", -float("inf")),
        ("self-play", float("nan")),
    ],
)
def test_weights_that_are_not_finite_are_refused(
    name: str, bad: float, runs: dict[str, Path], tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(runs[name], tmp_path / "run"))
    readers = [(folder, open_run), (folder, load_policy)]
    if name == "self-play":
        readers = [(folder, open_run), (folder / "chaser", load_policy)]
    for where, read in readers:
        state = load_checkpoint(where)
        trainee = state["trainee"]
        learner = (trainee["sides"]["chaser"] if "sides" in trainee else trainee)["learner"]
        weights = learner.get("network") or {"table": learner["q_values"]}
        next(iter(weights.values())).view(-1)[0] = bad
        write_tensors(where / "checkpoint.pt", state)
        with pytest.raises(
            ValueError, match=r"does not match the settings.*is not finite"
        ) as caught:
            read(where)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("part", "changed"),
    [("hyper", {"num_games": 8}), ("hyper", {"width": 16}), ("task", {"maze": "3x3"})],
)
def test_the_checkpoint_of_other_settings_is_refused(
    part: str, changed: dict[str, Any], runs: dict[str, Path], tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(runs["dqn"], tmp_path / "run"))
    plain = json.loads((folder / "config.json").read_text())
    plain[part] |= changed
    (folder / "config.json").write_text(json.dumps(plain))
    with pytest.raises(ValueError, match="does not match the settings") as caught:
        open_run(folder)
    assert "\n" not in str(caught.value)


def test_a_budget_beyond_all_numbers_is_refused(runs: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(runs["table"], tmp_path / "run"))
    plain = json.loads((folder / "config.json").read_text())
    for frames, said in (
        (1e308, r"frames=1e\+308; give a whole number"),
        (10**400, r"below 2\*\*63"),
    ):
        (folder / "config.json").write_text(json.dumps({**plain, "frames": frames}))
        with pytest.raises(ValueError, match=said):
            load_settings(folder)


def test_the_first_number_that_is_not_finite_is_found() -> None:
    tree = {"a": torch.zeros(2), "b": [{"c": torch.tensor([0.0, float("inf")])}], "d": "text"}
    assert first_not_finite(tree) == "b.0.c" and first_not_finite({"a": torch.arange(3)}) is None
