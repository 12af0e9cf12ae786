"""Commands with invalid arguments: each succeeds, or exits with one line and status 2."""

from __future__ import annotations

from pathlib import Path
from random import Random

from children import Outcome, call

CASES = 300
TINY = "--maze 3x3 --frames 600 --max-steps 40 --num-games 16 --threads 1 --episodes 20 --out OUT"
BATCH = "--minibatch-size 64"
BASES = (
    f"train {TINY} {BATCH}",
    f"train --task maze --num-goals 2 {TINY} {BATCH}",
    f"train --task heist --num-goals 1 --role evader {TINY} {BATCH}",
    f"train --algorithm dqn {TINY}",
    f"train --algorithm q_learning {TINY}",
    f"train --curriculum opponent-epsilon {TINY} {BATCH}",
    f"train --curriculum level-replay --task maze --num-goals 2 {TINY} {BATCH}",
    f"train --preset thesis-a2c {TINY}",
    "train --resume CHASER",
    f"self-play --snapshots 2 {TINY} {BATCH}",
    f"self-play --evader astar {TINY} {BATCH}",
    "self-play --resume PLAY",
    "evaluate RUN --episodes 20",
    "evaluate RUN --opponent-epsilon 0.5 --out OUT.json",
    "render RUN --out OUT.gif --episodes 1",
    "render --task race --maze 3x3 --out OUT.gif --episodes 1",
    "maze 5x5",
    "maze --generate prim --height 5 --width 6 --loops 0.2 --seed 3 --out OUT.txt",
    "maze --generate wilson --height 5 --no-dead-ends --picture OUT.png",
    "solve --maze 3x3 --out OUT.png",
    "solve --maze 2x2 --horizon 20 --stay-action --out OUT.png",
    "solve --maze 2x2 --num-chasers 2 --discount 0.9 --out OUT.png",
    "baseline --task chase --maze 3x3 --episodes 50",
    "baseline --task maze --maze 3x3 --num-goals 2 --episodes 50",
    "baseline --task chase --maze 3x3 --num-chasers 2 --episodes 50",
    "league CHASER astar random --games 10 --out OUT",
    "league PLAY astar --games 10 --out OUT",
    "sweep SWEEP.toml --dry-run",
    "sweep --list",
    "sweep rewards --version short --dry-run --out OUT",
    "ablate adaptive --version short --dry-run --out OUT",
    "report RUN",
    "--help",
    "--version",
)
NONSENSE = (
    "-1",
    "0",
    "1",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "1e30",
    "1e-30",
    "1000000000",
    "99999999999999999999",
    "0.5",
    "1.5",
    "True",
    "None",
    "null",
    "",
    " ",
    "ppo",
    "equilibrium",
    "optimal",
    "learn",
    "5x6",
    "../..",
    "/",
    "/dev/null",
    "/proc/self/mem",
    "RUN",
    "RUN/checkpoint.pt",
    "RUN/config.json",
    "PLAY",
    "PLAY/chaser",
    "EMPTY",
    "SWEEP.toml",
    "evil:Payload",
    "os:system",
    "evil",
    "é𝄞",
    "--",
    "-",
    "--help",
    "[1, 2]",
    "{}",
    "a" * 5000,
    "chaser",
    "chaser_7",
    "evader",
    "step=-0.1,capture=1e999",
    "goal",
    "15x15",
    "auto",
    "\x1b[31m",
)
OPTIONS = (
    "--maze",
    "--task",
    "--role",
    "--num-chasers",
    "--num-evaders",
    "--num-runners",
    "--num-goals",
    "--max-steps",
    "--min-start-distance",
    "--rewards",
    "--opponent",
    "--opponent-epsilon",
    "--start",
    "--move-order",
    "--seed",
    "--learning-rate",
    "--gamma",
    "--num-games",
    "--minibatch-size",
    "--rollout-steps",
    "--hidden",
    "--algorithm",
    "--curriculum",
    "--observation",
    "--evaluate",
    "--frames",
    "--seconds",
    "--device",
    "--precision",
    "--threads",
    "--sampling",
    "--members",
    "--chaser",
    "--evader",
    "--out",
    "--resume",
    "--episodes",
    "--discount",
    "--games",
    "--bogus",
    "--workers",
    "--executor",
    "--version",
)


def case(random: Random, folder: Path, stock: Path) -> tuple[str, list[str]]:
    """Execute one command: its description, and its faults."""
    words = nonsense(random)
    paths = {
        "RUN": stock / "ppo",
        "CHASER": stock / "chaser",
        "PLAY": stock / "self-play",
        "SWEEP": stock / "sweep",
        "EMPTY": stock / "empty",
        "OUT": folder / "out",
    }
    arguments = [_placed(word, paths) for word in words]
    outcome: Outcome = call(arguments, folder)
    return f"pursuit {' '.join(words)}", [f"{f}: {outcome.last_line()}" for f in outcome.faults()]


def nonsense(random: Random) -> list[str]:
    """A valid command with one to three random mistakes."""
    words = random.choice(BASES).split()
    for _ in range(random.choice((1, 1, 2, 3))):
        at = random.randrange(1, len(words)) if len(words) > 1 else 0
        kind = random.random()
        if kind < 0.45:
            values = [i for i in range(1, len(words)) if not words[i].startswith("--")] or [at]
            words[random.choice(values)] = random.choice(NONSENSE)
        elif kind < 0.75:
            words[len(words) :] = [random.choice(OPTIONS), random.choice(NONSENSE)]
        elif kind < 0.85:
            del words[at]
        elif kind < 0.95:
            words.insert(at, random.choice((*OPTIONS, *NONSENSE)))
        else:
            words[0] = random.choice(NONSENSE)
        words = words or ["train"]
    return words


def _placed(word: str, paths: dict[str, Path]) -> str:
    for name, path in paths.items():
        if word == name or word.startswith((f"{name}/", f"{name}.")):
            return str(path) + word[len(name) :]
    return word
