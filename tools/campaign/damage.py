"""Folders with a damaged or malicious file: each is read, or refused with one line."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from random import Random
from shutil import copytree
from typing import Any

from children import call

CASES = 500
SMALL = "--maze 3x3 --max-steps 40 --threads 1 --num-games 16 --frames 1500 --episodes 20"
BATCH = "--minibatch-size 64"
SWEEP = """
title = "two"
seeds = [0, 1]
episodes = 20
[settings]
maze = "3x3"
frames = 600
num_games = 16
max_steps = 40
threads = 1
minibatch_size = 64
[grid]
algorithm = ["ppo"]
"""
STOCK = {
    "ppo": f"train {BATCH} --curriculum level-replay --task maze --num-goals 2 {SMALL}",
    "q_learning": f"train --algorithm q_learning {SMALL}",
    "dqn": f"train --algorithm dqn {SMALL}",
    "chaser": f"train {BATCH} --curriculum opponent-epsilon {SMALL}",
    "self-play": f"self-play {BATCH} {SMALL} --snapshots 3",
    "sweep": "sweep sweep.toml --workers 1",
}
READERS = {
    "ppo": ("train --resume X", "evaluate X --episodes 20", "render X --out r.gif", "levels X"),
    "q_learning": ("train --resume X", "evaluate X --episodes 20"),
    "dqn": ("train --resume X", "evaluate X --episodes 20"),
    "chaser": (
        "train --resume X",
        "league X astar --games 10 --out l",
        "train --role evader --opponent X --maze 3x3 --frames 100 --num-games 16 "
        "--minibatch-size 64 --threads 1 --out o",
        "render X --out r.gif --episodes 1",
    ),
    "self-play": (
        "self-play --resume X",
        "league X astar --games 10 --out l",
        "evaluate X/chaser --episodes 20",
    ),
    "sweep": ("sweep X/../sweep.toml --out X --workers 1", "report X"),
}
VALUES: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    2**63,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "x",
    "../../etc/passwd",
    "evil:Payload",
    "\ud800",
    [],
    [1, [2, [3]]],
    {},
    {"evil": {"evil": "evil:Payload"}},
    "a" * 10_000,
)


class Payload:
    """An object that writes a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return (open, (str(self.mark), "w"))


def make_stock(stock: Path) -> None:
    """Make one finished run of each kind, an empty folder, and a module that writes a file."""
    stock.mkdir(parents=True, exist_ok=True)
    (stock / "empty").mkdir(exist_ok=True)
    (stock / "sweep.toml").write_text(SWEEP)
    for name, command in STOCK.items():
        outcome = call([*command.split(), "--out", name], stock, limit=120.0)
        if outcome.status != 0:
            raise RuntimeError(f"{name}: {outcome.err or outcome.out}")


def case(random: Random, folder: Path, stock: Path) -> tuple[str, list[str]]:
    """Execute a command that reads a damaged folder: its description, and its faults."""
    name = random.choice([*STOCK, *STOCK, "ppo", "q_learning", "dqn"])  # the others take longer
    mark = folder / "mark"
    (folder / "evil.py").write_text(f"open({str(mark)!r}, 'w')\nPayload = print\n")
    copytree(stock / name, folder / name)
    (folder / "sweep.toml").write_text(SWEEP)
    ended = [p for p in (folder / name).rglob("*") if p.is_file() and "events.out" not in p.name]
    path = random.choice(sorted(ended))
    what = damage(path, random, mark)
    quick = READERS[name][:2]
    command = random.choice((*READERS[name], *quick, *quick)).replace("X", name)
    outcome = call(command.split(), folder, limit=60.0)
    faults = [f"{fault}: {outcome.last_line()}" for fault in outcome.faults()]
    if mark.exists():
        faults.append("code from a file was run")
    return f"{path.relative_to(folder)} {what}; pursuit {command}", faults


def damage(path: Path, random: Random, mark: Path) -> str:
    """Damage a file; returns a description."""
    kind = random.random()
    content = path.read_bytes()
    if kind < 0.08:
        path.unlink()
        return "deleted"
    if kind < 0.16:
        path.write_bytes(content[: random.randrange(len(content) + 1)])
        return "cut"
    if kind < 0.2:
        path.unlink()
        path.mkdir()
        return "is a folder"
    if kind < 0.28:
        path.write_bytes(random.choice((b"", b"\x00" * 100, b"\xff\xfe", b"[]", b"null", b"{}")))
        return "is something else"
    if kind < 0.36:
        path.write_bytes(pickle.dumps(Payload(mark)))
        return "is a pickle that runs code"
    if path.suffix == ".json" and kind < 0.95:
        return _damage_json(path, random)
    if path.suffix == ".pt" and kind < 0.8:
        return _damage_checkpoint(path, random)
    if path.suffix == ".csv" and kind < 0.9:
        return _damage_csv(path, random)
    flipped = bytearray(content)
    for _ in range(random.choice((1, 3, 50))):
        if flipped:
            flipped[random.randrange(len(flipped))] ^= 1 << random.randrange(8)
    path.write_bytes(bytes(flipped))
    return "has flipped bits"


def _damage_json(path: Path, random: Random) -> str:
    content = json.loads(path.read_text())
    place, holder = _somewhere(content, random)
    if holder is None:
        content = random.choice(VALUES)
    else:
        _tamper(holder, random)
    path.write_text(json.dumps(content))
    return f"tampered with at {place}"


def _damage_checkpoint(path: Path, random: Random) -> str:
    import torch

    content = torch.load(path, weights_only=True)
    place, holder = _somewhere(content, random)
    if holder is not None:
        _tamper(holder, random, (*VALUES[:7], torch.zeros(3), torch.full((2, 2), float("nan"))))
    torch.save(content, path)
    return f"tampered with at {place}"


def _damage_csv(path: Path, random: Random) -> str:
    rows = [line.split(",") for line in path.read_text().splitlines()]
    row = random.choice(rows)
    row[random.randrange(len(row))] = random.choice(("", "x", "nan", "1e999", "a,b", '"', "\x00"))
    if random.random() < 0.3:
        rows = rows[1:]
    path.write_text("\n".join(",".join(row) for row in rows))
    return "has nonsense in a cell"


def _somewhere(content: Any, random: Random) -> tuple[str, Any]:
    """A random nested dict or list, and its path."""
    place, holder = "$", content if isinstance(content, dict | list) and content else None
    while holder is not None:
        inner = [
            (key, value)
            for key, value in (holder.items() if isinstance(holder, dict) else enumerate(holder))
            if isinstance(value, dict | list) and value
        ]
        if not inner or random.random() < 0.35:
            break
        key, holder = random.choice(inner)
        place += f".{key}"
    return place, holder


def _tamper(holder: Any, random: Random, values: tuple[Any, ...] = VALUES) -> None:
    key = random.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    kind = random.random()
    if kind < 0.7:
        holder[key] = random.choice(values)
    elif kind < 0.9:
        del holder[key]
    elif isinstance(holder, dict):
        holder["unheard"] = random.choice(values)
    else:
        holder.append(random.choice(values))
