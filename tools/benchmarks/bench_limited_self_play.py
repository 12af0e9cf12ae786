"""Self-play with limited views: `python tools/benchmarks/bench_limited_self_play.py --out FOLDER`.

PPO against PPO on 5x5-tree, where the chaser, or both agents, see two steps: without memory, with
four stacked observations, and with a GRU, at equal frames; and without memory at eight times as
many. Prints one row per run in discounted steps. Complete runs in the folder are not repeated.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import train
from pursuit.simulator.policy import Policy
from scripted_agents.environments import scripted_policy
from train.evaluation.matchups import discounted_steps
from train.files import write_text
from train.kinds import open_run
from train.self_play.parts import self_play_settings_of
from train.settings.self_play import OPPOSING_ROLES

FRAMES = 2_000_000
GAMES = 4000
MEMORIES: dict[str, dict[str, Any]] = {
    "none": {},
    "GRU": {"recurrent": "gru"},
    "4 observations": {"frame_stack": 4},
    "none, 8 times the frames": {"frames": 8 * FRAMES},
}
AGAINST = {"chaser": ("equilibrium", "astar", "searching"), "evader": ("equilibrium", "searching")}
"""The scripted opponents of each role."""


def settings_of(views: str, memory: str, seed: int) -> Any:
    """The settings of one run; an evader that sees everything has no GRU."""
    own = dict(MEMORIES[memory])
    if views == "chaser=2" and "recurrent" in own:
        own = {"chaser": own}
    return self_play_settings_of(
        **{"maze": "5x5-tree", "view_radius": views, "seed": seed, "frames": FRAMES} | own,
        threads=1,
        best_response_seconds=0.0,
    )


def scores(job: tuple[Path, str, str, int]) -> dict[str, Any]:
    """Train, unless it is done, and measure one pair of policies."""
    out, views, memory, seed = job
    folder = out / f"{views}-{memory}-{seed}".replace(" ", "_").replace(",", "").replace("=", "_")
    path = folder / "scores.json"
    if path.exists():
        return dict(json.loads(path.read_text()))
    settings = settings_of(views, memory, seed)
    run = open_run(folder) if folder.exists() else train.start("self-play", settings, folder)
    run.train()
    task, results = settings.task.build(), run.results()
    pair: dict[str, Policy] = {role: run.trainee.policy(role) for role in OPPOSING_ROLES}
    found: dict[str, Any] = {"views": views, "memory": memory, "seed": seed}
    found |= {"seconds": results["seconds"], "pair": value(task, pair)}
    found["bounds"] = results.get("limited_best_responses", {})
    for role, names in AGAINST.items():
        other = "evader" if role == "chaser" else "chaser"
        for name in names:
            scripted = scripted_policy(name, other, 0.2 if name == "astar" else 0.0)
            found[f"{role} against {name}"] = value(task, {role: pair[role], other: scripted})
    write_text(path, json.dumps(found))
    return found


def value(task: Any, pair: dict[str, Policy]) -> float:
    """The discounted steps of a pair: exact without memory, otherwise the mean of `GAMES`."""
    return discounted_steps(task, pair["chaser"], pair["evader"], 0.95, GAMES)


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    jobs = [
        (given.out, views, memory, seed)
        for memory in MEMORIES
        for seed in range(given.seeds)
        for views in ("chaser=2", "2")
    ]
    with ProcessPoolExecutor(given.processes, get_context("spawn")) as executor:
        for found in executor.map(scores, jobs):
            numbers = {name: round(x, 3) for name, x in found.items() if isinstance(x, float)}
            print(found["views"], found["memory"], found["seed"], numbers, found["bounds"])


if __name__ == "__main__":
    main()
