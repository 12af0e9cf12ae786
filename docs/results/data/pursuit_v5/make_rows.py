"""The runs of docs/results/pursuit_v5.md: train, then play inside PettingZoo's pursuit_v5.

    OMP_NUM_THREADS=1 python docs/results/data/pursuit_v5/make_rows.py LEARNER SEED [--seconds S]
    OMP_NUM_THREADS=1 python docs/results/data/pursuit_v5/make_rows.py judged
    OMP_NUM_THREADS=1 python docs/results/data/pursuit_v5/make_rows.py search

LEARNER is one of LEARNERS (the preset sisl-pursuit with these changes), sb3 (Stable-Baselines3
with SuperSuit, with the settings that the search chose), or one of SCRIPTED. `judged` makes all
rows of `runs.csv` that are missing, `search` those of `trials.csv`. Other settings are pilots:
`--set NAME=VALUE ...` adds a row to `pilots.csv`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock

import pursuit
import train
from pursuit.rules.arrays import Array
from scripted_agents import AStarChaser, GatheringTeam, UniformAgent
from train.evaluation.pursuit_v5 import (
    PursuitV5Episodes,
    environments,
    play_episodes,
    play_pursuit_v5,
)
from train.files import Plain, read_csv, write_csv
from train.machine import commit, processor, versions
from train.runs import loop
from train.runs.folder import RUN
from train.settings.presets import preset_task
from train.settings.task import TaskSettings

OUT = Path(__file__).parent
JUDGED_ON, CHOSEN_ON = range(3_000_000, 3_000_020), range(2_000_000, 2_000_005)
"""The seeds of the episodes in PettingZoo of judged runs, and of pilots and trials; training uses
none of them."""
SIMULATED = 100
"""Episodes of a score in our simulator."""
LEARNERS: dict[str, Plain] = {
    "ippo": {},
    "imitation": {"imitate": "gathering", "imitate_frames": 4_000_000},
}
SCRIPTED: dict[str, Callable[[], Any]] = {
    "gathering": GatheringTeam,
    "astar": AStarChaser,
    "random": UniformAgent,
}
JUDGED = [
    *((name, 0, 0.0) for name in SCRIPTED),
    *((learner, seed, 600.0) for seed in range(5) for learner in ("ippo", "sb3")),
    *((learner, seed, 120.0) for seed in range(5) for learner in LEARNERS),
    *(("ippo", seed, 3600.0) for seed in range(3)),
]
"""(learner, seed, processor seconds) of the judged runs, in their order."""
TRIALS, TRIAL_SECONDS = 30, 120.0
"""The search for the settings of Stable-Baselines3."""
RANGES: dict[str, list[Any]] = {
    "own_rewards": [False, True],
    "agent_number": [False, True],
    "copies": [2, 4, 8],
    "n_steps": [16, 32, 64, 128],
    "batch_size": [128, 256, 512, 1024],
    "n_epochs": [2, 4, 8],
    "learning_rate": [3e-4, 1e-3, 2e-3],
    "gamma": [0.95, 0.98, 0.99],
    "gae_lambda": [0.8, 0.95],
    "ent_coef": [0.001, 0.003, 0.01],
    "width": [64, 128, 256],
}
"""What the search draws from, uniformly: the values that pilots of the preset had, and the usual
ones of Stable-Baselines3."""
Trained = tuple[int, float, dict[str, PursuitV5Episodes]]
"""The agent steps and the processor seconds of training, and the episodes by where they are
played."""


def ours(how: Plain, seed: int, seconds: float, starts: range) -> Trained:
    """A run of the preset with other settings."""
    loop.EVALUATIONS = 0  # they are not in the budget, but take longer than it
    how = {"clock": "processor", "threads": 1, "seed": seed, "log": "none", **how}
    settings = train.settings_of(preset="sisl-pursuit", seconds=seconds, **how)
    with tempfile.TemporaryDirectory() as folder:
        run: Any = train.start(RUN, settings, Path(folder))
        run.train()
        spent, found = run.seconds, dict[str, PursuitV5Episodes]()
        for name, greedy in (("", False), (", greedy", True)):
            policy = run.trainee.learner.policy(greedy)
            found[f"pettingzoo{name}"] = play_pursuit_v5(policy, len(starts), starts[0])
            found[f"simulator{name}"] = simulated(policy, starts[0])
    return run.trainee.frames, spent, found


def pettingzoo(how: Plain, seed: int, seconds: float, starts: range) -> Trained:
    """Stable-Baselines3's PPO with parameter sharing by SuperSuit, trained in PettingZoo."""
    import supersuit
    from stable_baselines3 import PPO
    from stable_baselines3.common.utils import set_random_seed

    torch.set_num_threads(1)
    own = dict(how)
    rewards, number = own.pop("own_rewards"), own.pop("agent_number")
    copies, width = own.pop("copies"), own.pop("width")

    def seen_by_learner(env: Any) -> Any:
        return supersuit.agent_indicator_v0(env) if number else env

    (alone,) = environments(1, shared_reward=not rewards)
    env = supersuit.pettingzoo_env_to_vec_env_v1(seen_by_learner(alone))
    env = supersuit.concat_vec_envs_v1(env, copies, num_cpus=1, base_class="stable_baselines3")
    set_random_seed(seed)
    network = {"net_arch": [width, width]}
    left = [own.pop("learning_rate")]
    began = time.process_time()

    def annealed(_: float) -> float:
        return float(left[0] * max(1.0 - (time.process_time() - began) / seconds, 0.0))

    model = PPO(
        "MlpPolicy", env, device="cpu", policy_kwargs=network, learning_rate=annealed, **own
    )
    for copy, each in enumerate(env.venv.vec_envs):  # SuperSuit's copies draw the same numbers
        each.par_env.reset(seed=100 * seed + copy)
    began = time.process_time()
    model.learn(10**12, callback=lambda *_: time.process_time() - began < seconds)
    spent, found = time.process_time() - began, dict[str, PursuitV5Episodes]()
    for name, greedy in (("", False), (", greedy", True)):

        def choose(seen: Array, greedy: bool = greedy) -> Array:
            flat = model.predict(seen.reshape(-1, *seen.shape[2:]), deterministic=greedy)[0]
            return np.asarray(flat).reshape(seen.shape[:2])

        envs = [seen_by_learner(each) for each in environments(len(starts))]
        found[f"pettingzoo{name}"] = play_episodes(envs, choose, starts[0])
    return model.num_timesteps, spent, found


def simulated(policy: Any, seed: int) -> PursuitV5Episodes:
    """Episodes in our simulator, whose mean rewards are those of the environment."""
    task = TaskSettings(**preset_task("sisl-pursuit", TaskSettings)).build()
    games = pursuit.Simulator(task, SIMULATED, seed, auto_restart=False)
    actions = np.zeros((SIMULATED, task.num_agents), dtype=np.int32)
    policies = [policy] * 8 + [UniformAgent()] * 30
    while not (games.terminated | games.truncated).all():
        games.act(policies, actions)
        games.step(actions)
    caught = (games.active[:, 8:] == 0).sum(axis=1)
    returns = games.returns[:, :8].astype(float)
    return PursuitV5Episodes(returns, games.steps.astype(int), caught)


def scripted(policy: Any, starts: range) -> Trained:
    """Nothing is trained."""
    inside = play_pursuit_v5(policy, len(starts), starts[0])
    return 0, 0.0, {"pettingzoo": inside, "simulator": simulated(policy, starts[0])}


def chosen_for_sb3() -> Plain:
    """The settings of the trial with the highest return."""
    rows = [row for row in read_csv(OUT / "trials.csv") if row["played_in"] == "pettingzoo"]
    best = max(rows, key=lambda row: float(row["mean_return"]))
    found: Plain = json.loads(best["settings"])
    return found


def add_rows(
    path: Path, learner: str, seed: int, seconds: float, how: Plain, starts: range
) -> None:
    """Train, play, and add the rows of a run to a file."""
    if learner in SCRIPTED:
        steps, spent, played = scripted(SCRIPTED[learner](), starts)
    elif learner == "sb3":
        steps, spent, played = pettingzoo(how, seed, seconds, starts)
    else:
        steps, spent, played = ours(how, seed, seconds, starts)
    about = {"learner": learner, "settings": json.dumps(how), "seed": seed, "seconds": seconds}
    about |= {"agent_steps": steps, "processor_seconds": round(spent, 1)}
    where = {"torch": versions()["torch"], "commit": commit(), "processor": processor()}
    with FileLock(f"{path}.lock"):
        rows: list[Plain] = [*read_csv(path)] if path.exists() else []
        for place, episodes in played.items():
            rows.append({**about, "played_in": place, **episodes.summary(), **where})
            print(rows[-1], flush=True)
        write_csv(path, rows)


def missing(path: Path, jobs: list[tuple[str, int, float]]) -> list[tuple[str, int, float]]:
    """The jobs without rows in a file."""
    rows = read_csv(path) if path.exists() else []
    made = {(row["learner"], int(row["seed"]), float(row["seconds"])) for row in rows}
    return [job for job in jobs if job not in made]


def main() -> None:
    """Make the rows of one run, of all judged runs, or of the search."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("learner", choices=[*LEARNERS, *SCRIPTED, "sb3", "judged", "search"])
    parser.add_argument("seed", type=int, nargs="?", default=0)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE")
    parser.add_argument("--only", nargs="*", help="learners of `judged`")
    parser.add_argument("--seeds", nargs="*", type=int, help="seeds of `judged`")
    given = parser.parse_args()
    if given.learner == "search":
        for _, trial, seconds in missing(
            OUT / "trials.csv", [("sb3", trial, TRIAL_SECONDS) for trial in range(TRIALS)]
        ):
            rng = np.random.default_rng(trial)
            how = {name: rng.choice(values).item() for name, values in RANGES.items()}
            add_rows(OUT / "trials.csv", "sb3", trial, seconds, how, CHOSEN_ON)
        return
    if given.learner == "judged":
        for learner, seed, seconds in missing(OUT / "runs.csv", JUDGED):
            chosen = given.only is None or learner in given.only
            if chosen and (given.seeds is None or seed in given.seeds):
                how = chosen_for_sb3() if learner == "sb3" else LEARNERS.get(learner, {})
                add_rows(OUT / "runs.csv", learner, seed, seconds, how, JUDGED_ON)
        return
    how = chosen_for_sb3() if given.learner == "sb3" else dict(LEARNERS.get(given.learner, {}))
    for text in given.set:
        name, _, value = text.partition("=")
        try:
            how[name] = json.loads(value)
        except ValueError:
            how[name] = value
    add_rows(OUT / "pilots.csv", given.learner, given.seed, given.seconds, how, CHOSEN_ON)


if __name__ == "__main__":
    main()
